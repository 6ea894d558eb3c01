"""Chains scenes into one long road; the traffic of each scene starts when the ego reaches it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import Junction, RoadLayout
from raw2drive_ros.simulation.road_builder import build_road
from raw2drive_ros.simulation.scenario import (
    AcrossJunction,
    ActorSpec,
    AlongRoad,
    CarSpec,
    FlowSpec,
    Place,
    Scene,
    TrafficSpec,
)
from raw2drive_ros.simulation.scripts import Meeting, Pacing, Script

DRAWS_PER_LINK = 40


@dataclass(frozen=True, slots=True)
class Link:
    """A scene with the length of its road, along the ego's lane and along the oncoming lane."""

    scene: Scene
    forward_m: float
    backward_m: float


def is_chainable(scene: Scene) -> bool:
    """Whether a scene can be part of a chain: one lane each way, and a route along its own lane from start to end."""
    layout, route = scene.layout, scene.route
    plain = route.lane == 0 and not route.changes and not route.from_ramp and not route.to_exit
    return plain and layout.forward_lanes == layout.backward_lanes == 1


def draw_chain(whole: Draw, draws: Sequence[Callable[[Draw], Scene]], length_m: float) -> Scene:
    """Scenes drawn by `draws` in random order, none of them twice in a row, until the road is `length_m` long.

    Raises LayoutError when the road cannot be continued without crossing itself.
    """
    links: list[Link] = []
    last = -1
    while sum(link.forward_m for link in links) < length_m:
        for attempt in range(DRAWS_PER_LINK):
            index = int(whole.rng.integers(len(draws)))
            scene = draws[index](whole.part(f'link_{len(links)}_{attempt}'))
            if index == last:
                continue
            try:
                build_road(_layout([*(link.scene for link in links), scene]))
            except LayoutError:
                continue
            road = build_road(scene.layout)
            links.append(Link(scene, road.forward_path().end_s_m, road.backward_path().end_s_m))
            last = index
            break
        else:
            raise LayoutError(f'no room for another scene after {len(links)}')
    return joined(links)


def joined(links: Sequence[Link]) -> Scene:
    """All links as one scene: arc lengths, junction numbers and triggers are shifted to where each link begins."""
    found = Scene(_layout([link.scene for link in links]), replace(links[0].scene.route, detour=()))
    begin, after, junctions = 0.0, sum(link.backward_m for link in links), 0
    zebras: list[float] = []
    for link in links:
        after -= link.backward_m
        scene = link.scene
        shift = _Shift(begin, after, junctions, link)
        found = replace(
            found,
            route=replace(
                found.route,
                detour=found.route.detour + tuple(replace(c, s_m=c.s_m + begin) for c in scene.route.detour),
            ),
            actors=found.actors + tuple(shift.actor(spec) for spec in scene.actors),
            lights=found.lights + tuple(replace(x, junction=x.junction + junctions) for x in scene.lights),
            stop_signs=found.stop_signs + tuple(replace(x, junction=x.junction + junctions) for x in scene.stop_signs),
            disturbances=found.disturbances + tuple(replace(x, s_m=x.s_m + begin) for x in scene.disturbances),
            later_events_s_m=found.later_events_s_m + tuple((a + begin, b + begin) for a, b in scene.events_s_m),
            background=found.background or scene.background,
        )
        zebras += [s_m + begin for s_m in scene.layout.zebras_m]
        junctions += sum(isinstance(piece, Junction) for piece in scene.layout.pieces)
        begin += link.forward_m
    return replace(found, layout=replace(found.layout, zebras_m=tuple(zebras)))


def _layout(scenes: Sequence[Scene]) -> RoadLayout:
    """The road alone, without zebra crossings: their arc lengths depend on where each link begins."""
    layouts = [scene.layout for scene in scenes]
    return RoadLayout(
        tuple(piece for layout in layouts for piece in layout.pieces),
        1,
        1,
        speed_limit_mps=min(layout.speed_limit_mps for layout in layouts),
        shoulder_m=max(layout.shoulder_m for layout in layouts),
    )


@dataclass(frozen=True, slots=True)
class _Shift:
    """Shifts the actors of a link: where it begins on the forward chain, how much of the backward chain and how many
    junctions come before it."""

    begin_m: float
    after_m: float
    junctions: int
    link: Link

    def actor(self, spec: ActorSpec) -> ActorSpec:
        starts_m = self.begin_m + self.link.scene.route.start_s_m if self.begin_m else 0.0
        if isinstance(spec, FlowSpec):
            ends_m = self.begin_m + self.link.forward_m
            return replace(spec, place=self._place(spec.place), from_s_m=starts_m, until_s_m=ends_m)
        if isinstance(spec, CarSpec):
            return replace(
                spec,
                place=self._place(spec.place),
                scripts=tuple(self._script(script) for script in spec.scripts),
                pacing=self._steered(spec.pacing),
                waits_for_s_m=starts_m,
            )
        if not isinstance(spec, TrafficSpec):
            return replace(spec, s_m=spec.s_m + self.begin_m)
        # A path across a junction begins at the far end of an arm, so it does not depend on where the link begins.
        shift, ends = 0.0, spec.ends_at_s_m
        if spec.on == 'forward':
            shift, ends = self.begin_m, self.begin_m + self.link.forward_m
        elif spec.on == 'backward':
            shift, ends = self.after_m, self.after_m + self.link.backward_m
        return replace(
            spec,
            s_m=spec.s_m + shift,
            scripts=tuple(self._script(script) for script in spec.scripts),
            junction=spec.junction + self.junctions,
            pacing=self._pacing(spec.pacing),
            waits_for_s_m=starts_m,
            ends_at_s_m=ends,
        )

    def _pacing(self, pacing: Pacing | None) -> Pacing | None:
        return pacing and replace(pacing, until_s_m=pacing.until_s_m + self.begin_m)

    def _steered(self, steered: Pacing | Meeting | None) -> Pacing | Meeting | None:
        if isinstance(steered, Meeting):
            own_s_m, ego_s_m = steered.own_s_m + self.begin_m, steered.ego_s_m + self.begin_m
            return replace(steered, own_s_m=own_s_m, ego_s_m=ego_s_m)
        return self._pacing(steered)

    def _place(self, place: Place) -> Place:
        """Raises ValueError for a place on an on-ramp: chains have none."""
        if isinstance(place, AlongRoad):
            return replace(place, at_m=place.at_m + self.begin_m)
        if isinstance(place, AcrossJunction):
            return replace(place, junction=place.junction + self.junctions)
        raise ValueError('a chain has no on-ramps')

    def _script(self, script: Script) -> Script:
        at, due = script.ego_at_s_m, script.ego_due
        return replace(
            script,
            ego_at_s_m=None if at is None else at + self.begin_m,
            ego_due=None if due is None else (due[0] + self.begin_m, due[1]),
        )
