"""Long routes: two kilometres and more with a series of events, like the validation routes of Leaderboard 2.0."""

from __future__ import annotations

from collections.abc import Callable

from raw2drive_ros.simulation.chain import draw_chain, is_chainable
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.scenario import Scene, load_scenarios, no_extra_rule, scenario

LENGTH_M = 2000.0


def chainable_draws() -> list[Callable[[Draw], Scene]]:
    """Draw functions of the benchmark types that fit onto a road with one lane each way and have no own rule."""
    return [
        kind.draw
        for kind in load_scenarios().values()
        if kind.abilities and kind.rule is no_extra_rule and is_chainable(kind.draw(Draw(kind.name, 0)))
    ]


@scenario('LongRoute')
def long_route(draw: Draw) -> Scene:
    """Events of all abilities one after another on a road of two kilometres."""
    return draw_chain(draw, chainable_draws(), LENGTH_M)
