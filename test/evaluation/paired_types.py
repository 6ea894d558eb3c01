"""Two small types with twins, for tests: `PairedWalker`, which needs eyes, and `PairedEmpty`, which needs none."""

from raw2drive_ros.simulation import scenario
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.scenario import RouteSpec, Scenario, Scene, StandingSpec, WalkerSpec

WALKER, EMPTY = 'PairedWalker', 'PairedEmpty'


def walker_scene(draw: Draw) -> Scene:
    """Somebody stands at the kerb, and in the event crosses before the ego."""
    place = draw.uniform('place', 45.0, 95.0, key=True)
    limit = draw.uniform('limit', 8.0, 12.0, key=True)
    pace = draw.uniform('pace', 0.9, 1.4, key=True)
    side = draw.side('side')
    crosses = WalkerSpec(place, 4.5 * side, -4.5 * side if draw.event else 4.4 * side, pace, 0.2)
    if not draw.event:
        # Who turns to the road without a step onto it.
        crosses = WalkerSpec(place, 4.5 * side, 4.45 * side, pace, 0.2)
    return Scene(RoadLayout((Straight(150),), speed_limit_mps=limit), RouteSpec(), (crosses,))


def empty_scene(draw: Draw) -> Scene:
    """Nothing happens, whatever the twin says."""
    length = draw.uniform('length', 90.0, 130.0, key=True)
    limit = draw.uniform('limit', 8.0, 12.0, key=True)
    box = StandingSpec('barrier', 40.0, draw.uniform('aside', 6.0, 9.0))
    return Scene(RoadLayout((Straight(length),), speed_limit_mps=limit), RouteSpec(), (box,))


def register(monkeypatch) -> None:
    """For the length of a test."""
    for name, draw in ((WALKER, walker_scene), (EMPTY, empty_scene)):
        monkeypatch.setitem(scenario.REGISTRY, name, Scenario(name, ('EmergencyBrake',), draw, paired=True))
