"""From the specifications of a scene to its actors, lights, signs and traffic."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.simulation.actors import Actor, CarDoor, Look, PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.background import Background
from raw2drive_ros.simulation.courses import Course, Crossing, LaneRef
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.flows import Flow
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.right_of_way import main_arms
from raw2drive_ros.simulation.roads import ARM_TURN_RAD
from raw2drive_ros.simulation.roadside import Roadside, place_roadside
from raw2drive_ros.simulation.scenario import (
    AcrossJunction,
    ActorSpec,
    BackgroundSpec,
    CarSpec,
    DoorSpec,
    FlowSpec,
    LightSpec,
    OnRamp,
    Place,
    StandingSpec,
    TrafficSpec,
    WalkerSpec,
)
from raw2drive_ros.simulation.scripts import Meeting
from raw2drive_ros.simulation.signals import PolePose, Sign, StopSign, TrafficLight

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

# The conflict point of two paths is looked for within this distance of the junction's square.
JUNCTION_REACH_M = 2.0
# Points, so far apart, stand for a stretch that is kept clear.
CLEAR_STEP_M = 3.0
# Cycle of a light that the scene does not programme: (green, red) for the ego's approach.
CYCLE_S = (12.0, 16.0)


class WorldBuilder:
    """Builds what a scene specifies into a world that has its road and route."""

    def __init__(self, world: World) -> None:
        self.world, self.scene, self.road = world, world.scene, world.road
        self.paths: dict[tuple[object, int, int], Path] = {}

    # -- lights and signs -------------------------------------------------------------------------

    def lights(self) -> list[TrafficLight]:
        """The lights of the scene, and of junctions with a light that it does not mention."""
        specs = list(self.scene.lights)
        named = {spec.junction for spec in specs}
        for number, site in enumerate(self.road.junctions):
            if site.spec.control == 'light' and number not in named:
                green = float(self.world.draw.stream(f'light {number}').uniform(0.0, CYCLE_S[0]))
                phases = (('green', green), ('red', CYCLE_S[1]), ('green', CYCLE_S[0] - green))
                specs.append(LightSpec(number, phases, math.inf, repeats=True))
        return [self._light(spec) for spec in specs]

    def _light(self, spec: LightSpec) -> TrafficLight:
        entry, pole = self._junction_entry(spec.junction, beyond=True)
        return TrafficLight(entry, spec.phases, spec.trigger_m, pole, spec.junction, spec.held, spec.repeats)

    def stop_signs(self) -> list[StopSign]:
        """The stop signs that the ego has to obey."""
        return [StopSign(*self._junction_entry(spec.junction, beyond=False)) for spec in self.scene.stop_signs]

    def lamp_sites(self) -> list[tuple[PolePose, TrafficLight, str]]:
        """(pose of the pole, light, arm) of every approach of the junctions with a light."""
        found = []
        for light in self.world.lights:
            for arm in ('back', *self.road.junctions[light.junction].spec.arms):
                pole = light.pole_pose if arm == 'back' else self._pole(light.junction, arm, beyond=True)
                found.append((pole, light, arm))
        return found

    def signs(self) -> list[Sign]:
        """The signs of all approaches without right of way."""
        found = []
        for number, site in enumerate(self.road.junctions):
            main = main_arms(site.spec)
            if site.spec.control not in ('stop', 'yield'):
                continue
            for arm in ('back', *site.spec.arms):
                if arm not in main:
                    found.append(Sign(site.spec.control, self._pole(number, arm, beyond=False), number, arm))
        return found

    def _pole(self, junction: int, arm: str, *, beyond: bool) -> PolePose:
        """The pose of a pole right of the road, before or beyond a junction, that looks at approach `arm`."""
        site = self.road.junctions[junction]
        ref = self.world.book.approach_of(junction, arm)
        lane = self.world.book.lanes[ref]
        x, y, yaw = lane.pose(lane.length)
        along = 2.0 * site.half_size_m + 1.0 if beyond else -1.0
        lanes = self.world.book.count(ref)
        aside = -((lanes - ref[2] - 0.5) * lane.width + 1.5)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return x + along * cos - aside * sin, y + along * sin + aside * cos, yaw + math.pi

    def _junction_entry(self, junction: int, *, beyond: bool) -> tuple[float, PolePose]:
        """(arc length of the ego's stop line on the route, pose of a pole before or beyond the junction)."""
        site = self.road.junctions[junction]
        cos, sin = math.cos(site.heading_rad), math.sin(site.heading_rad)
        x, y = site.centre_m[0] - site.half_size_m * cos, site.centre_m[1] - site.half_size_m * sin
        line_s, _ = self.world.route.project(x, y)
        return line_s - 0.6, self._pole(junction, 'back', beyond=beyond)

    # -- the ego's route --------------------------------------------------------------------------

    def ego_crossings(self) -> dict[int, Crossing]:
        """The junctions of the route, by number."""
        book, route = self.world.book, self.world.route
        lane = min(round(self.scene.route.lane), self.scene.layout.forward_lanes - 1)
        found = {}
        for number, site in enumerate(self.road.junctions):
            ref = book.lane((f'c{site.piece}', f'c{site.piece + 1}'), lane)
            begin, end = book.lanes[ref].pose(0.0), book.lanes[ref].pose(book.lanes[ref].length)
            enter, leave = route.project(*begin[:2])[0], route.project(*end[:2])[0]
            turn = book.turn_of(ref)
            found[number] = Crossing(number, 'back', site.spec.turn, ref, turn, enter - 0.6, enter, leave)
        return found

    def own_lanes(self) -> set[LaneRef]:
        """The lanes of the route outside of junctions, before its start and beyond its end too."""
        lanes = {min(max(round(self.scene.route.lane), 0), self.scene.layout.forward_lanes - 1)}
        lanes |= {round(change.to_lane) for change in self.scene.route.changes}
        return {(*edge, lane) for edge in self.road.lanes_along(oncoming=False) for lane in lanes}

    # -- actors -----------------------------------------------------------------------------------

    def actor(self, spec: ActorSpec, rng: Rng) -> Actor:
        """The actor of a specification, not of a flow."""
        assert not isinstance(spec, FlowSpec)
        look = Look.draw('door' if isinstance(spec, DoorSpec) else spec.kind, rng, self.world.draw.split)
        route = self.world.route
        if isinstance(spec, WalkerSpec):
            walker = Walker(route, spec.s_m, spec.from_m, spec.to_m, spec.speed_mps, spec.delay_s, spec.kind, look)
            walker.left_to_walk_m *= spec.happens
            return walker
        if isinstance(spec, DoorSpec):
            return CarDoor(route, spec.s_m, spec.hinge_m, spec.due_s if spec.happens else 0.0, look)
        if isinstance(spec, StandingSpec):
            x, y, yaw = route.pose(spec.s_m, spec.lateral_m)
            return StandingObject(x, y, yaw + spec.yaw_rad, spec.kind, look)
        if isinstance(spec, CarSpec):
            return self._car(spec, look)
        return self._traffic(spec, look)

    def _car(self, spec: CarSpec, look: Look) -> PathVehicle:
        path, course, s_m = self.placed(spec.place, spec.then)
        if isinstance(spec.place, AcrossJunction):
            s_m -= look.length_m / 2
        steered: Meeting | None = None
        if spec.meets_ego:
            assert isinstance(spec.place, AcrossJunction)
            steered = self._meeting(spec.place.junction, path)
        car = PathVehicle(
            path,
            s_m,
            spec.speed_mps,
            spec.speed_mps if spec.target_speed_mps is None else spec.target_speed_mps,
            spec.kind,
            look,
            spec.scripts,
            ignores_traffic=spec.ignores_traffic,
            ignores_ego=spec.ignores_ego,
            lateral_m=spec.lateral_m,
            steered=steered or spec.pacing,
            time_gap_s=spec.time_gap_s,
            course=course,
            yields=spec.yields and not spec.ignores_traffic,
            obeys_lights=spec.obeys_lights and not spec.ignores_traffic,
        )
        car.leaves_in_sight = False
        return car

    def placed(self, place: Place, then: tuple[str, ...]) -> tuple[Path, Course | None, float]:
        """(path, course, arc length on it) of a place; an on-ramp has no course."""
        book = self.world.book
        if isinstance(place, OnRamp):
            return self._ramp_path(), None, place.at_m
        if isinstance(place, AcrossJunction):
            course = book.across(place.junction, place.source, place.target, place.lane, then)
            crossing = next(c for c in course.crossings if c.junction == place.junction)
            return course.path, course, crossing.stop_s_m - place.before_m
        x, y, _ = self.road.forward_path_cached().pose(place.at_m)
        edges = self.road.lanes_along(oncoming=place.oncoming)
        ref = min(
            (book.lane(edge, place.lane) for edge in edges),
            key=lambda ref: (book.distance_m(ref, x, y), ref),
        )
        course = book.through(ref, then)
        hint = course.station_of(ref) + book.lanes[ref].local_coordinates(np.array((x, y)))[0]
        return course.path, course, course.path.project(x, y, hint)[0]

    def _ramp_path(self) -> Path:
        return self.paths.setdefault(('ramp', 0, 0), self.road.ramp_path())

    def _traffic(self, spec: TrafficSpec, look: Look) -> PathVehicle:
        path = self._traffic_path(spec)
        waits = ()
        number = next((i for i, light in enumerate(self.scene.lights) if light.junction == spec.junction), None)
        if spec.obeys_light and number is not None:
            crosses = isinstance(spec.on, tuple) and spec.on[0] in ('left', 'right')
            entry = self._stop_line_s_m(spec, path)
            waits = ((entry, lambda world: world.lights[number].colour_for('left' if crosses else 'ahead') != 'green'),)
        target = spec.speed_mps if spec.target_speed_mps is None else spec.target_speed_mps
        return PathVehicle(
            path,
            spec.s_m,
            spec.speed_mps,
            target,
            spec.kind,
            look,
            spec.scripts,
            ignores_traffic=spec.ignores_traffic,
            waits_at_m=waits,
            lateral_m=spec.lateral_m,
            steered=self._meeting(spec.junction, path) if spec.meets_ego else spec.pacing,
            has_priority=spec.has_priority,
            time_gap_s=spec.time_gap_s,
            ends_at_s_m=spec.ends_at_s_m,
        )

    def _meeting(self, junction: int, path: Path) -> Meeting:
        own, ego = self._conflict(junction, path)
        return Meeting(own, ego)

    def _conflict(self, junction: int, path: Path) -> tuple[float, float]:
        """Arc lengths on a path and on the ego's route of the closest pair of points within a junction."""
        site, route = self.road.junctions[junction], self.world.route
        reach = site.half_size_m + JUNCTION_REACH_M
        own, ego = (np.abs(p.points_m - site.centre_m).max(axis=1) < reach for p in (path, route))
        own_at, ego_at = np.flatnonzero(own), np.flatnonzero(ego)
        gaps = path.points_m[own_at, None] - route.points_m[None, ego_at]
        i, j = np.unravel_index(np.argmin(np.einsum('abk,abk->ab', gaps, gaps)), (len(own_at), len(ego_at)))
        return path.station(int(own_at[i])), route.station(int(ego_at[j]))

    def _stop_line_s_m(self, spec: TrafficSpec, path: Path) -> float:
        """Arc length of a vehicle's stop line before junction `spec.junction`, on its path."""
        site = self.road.junctions[spec.junction]
        arm = spec.on[0] if isinstance(spec.on, tuple) else 'back'
        yaw = site.heading_rad + (math.pi if arm == 'back' else ARM_TURN_RAD[arm])
        x = site.centre_m[0] + (site.half_size_m + 0.6) * math.cos(yaw)
        y = site.centre_m[1] + (site.half_size_m + 0.6) * math.sin(yaw)
        return path.project(x, y)[0]

    def _traffic_path(self, spec: TrafficSpec) -> Path:
        """The path of a vehicle; vehicles on the same way share one."""
        key = (spec.on, spec.lane, spec.junction)
        if key not in self.paths:
            self.paths[key] = self._new_path(spec)
        return self.paths[key]

    def _new_path(self, spec: TrafficSpec) -> Path:
        if spec.on == 'forward':
            return self.road.forward_path(spec.lane)
        if spec.on == 'backward':
            return self.road.backward_path(spec.lane)
        if spec.on == 'ramp':
            return self.road.ramp_path()
        source, target = spec.on
        return self.road.crossing_path(spec.junction, source, target, spec.lane)

    # -- traffic that goes on ---------------------------------------------------------------------

    def flow(self, spec: FlowSpec, number: int) -> Flow:
        """The running flow of a specification. Raises ValueError for one on a ramp."""
        path, course, s_m = self.placed(spec.place, spec.then)
        if course is None:
            raise ValueError('FlowSpec: a flow on a ramp is not possible')
        if isinstance(spec.place, AcrossJunction):
            s_m, ego_s_m = self._conflict(spec.place.junction, path)
        else:
            ego_s_m = self.world.route.project(*path.pose(s_m)[:2])[0]
        return Flow(spec, course, s_m, ego_s_m, self._seeds(f'flow {number}'))

    def _seeds(self, name: str) -> list[int]:
        return [int(x) for x in self.world.draw.stream(name).integers(0, 2**31, 3)]

    def background(self, spec: BackgroundSpec, flows: list[Flow]) -> Background:
        """The running background, which keeps off the lanes that lead to a flow's point or are blocked."""
        book = self.world.book
        avoid: set[LaneRef] = set()
        for flow in flows:
            course = flow.course
            leading = [ref for ref, begin in zip(course.lanes, course.begins_m) if begin <= flow.point_s_m]
            avoid |= {ref for ref in leading if book.lanes[ref].junction < 0}
        blocking = [actor for actor in self.world.actors if isinstance(actor, StandingObject)]
        for ref, lane in book.lanes.items():
            if lane.junction < 0 and any(self._blocks(actor, ref) for actor in blocking):
                avoid.add(ref)
        sides = self._sides(spec)
        edges = set(self.road.forward) if 'right' not in sides else set(self.road.backward)
        background = Background(spec, book, avoid, self._seeds('background'))
        background.prepare(self.own_lanes(), edges if spec.cyclists else set())
        return background

    def _blocks(self, actor: StandingObject, ref: LaneRef) -> bool:
        lane = self.world.book.lanes[ref]
        along, lateral = lane.local_coordinates(actor.position)
        reach = lane.width / 2 + actor.WIDTH / 2 - 0.6
        return -2.0 < along < lane.length + 2.0 and abs(lateral) < reach

    def _sides(self, spec: BackgroundSpec) -> str:
        """The sides with parked cars; cyclists ride on the other one."""
        if not spec.parked:
            return ''
        if not spec.cyclists and self.world.draw.stream('parked on both sides').random() < 0.5:
            return 'both right left'
        return 'right' if self.world.draw.stream('parked side').random() < 0.5 else 'left'

    def roadside(self, spec: BackgroundSpec) -> Roadside:
        """Parked cars and people, away from the scene's own actors."""
        taken = [actor.position for actor in self.world.actors if not isinstance(actor, PathVehicle)]
        for spec_actor in self.scene.actors:
            if isinstance(spec_actor, CarSpec) and abs(spec_actor.lateral_m) > 1.0:
                path, _, s_m = self.placed(spec_actor.place, spec_actor.then)
                taken.append(np.array(path.pose(s_m, spec_actor.lateral_m)[:2]))
        if spec.clear_m is not None:
            taken += [np.array(self.world.route.pose(float(s))[:2]) for s in np.arange(*spec.clear_m, CLEAR_STEP_M)]
        sides = self._sides(spec)
        rng = self.world.draw.stream('roadside')
        return Roadside(
            place_roadside(self.road, spec, np.array(taken).reshape(-1, 2), sides, rng, self.world.draw.split)
        )
