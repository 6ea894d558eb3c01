"""The world of one episode: built from a `Scene`, stepped at the physics rate. No images, no reward."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.contracts.public import Control, Float64
from raw2drive_ros.simulation.actors import Actor, PathVehicle, Walker, fork_of
from raw2drive_ros.simulation.contact import Contact, resolve_contacts
from raw2drive_ros.simulation.courses import CourseBook
from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.ego import EgoParameters, EgoVehicle
from raw2drive_ros.simulation.ego_route import offset_m, route_path, speed_profile
from raw2drive_ros.simulation.flows import HIDDEN_M, Flow
from raw2drive_ros.simulation.leaders import PathBank, find_leaders_in
from raw2drive_ros.simulation.path import SPACING_M
from raw2drive_ros.simulation.right_of_way import RightOfWay
from raw2drive_ros.simulation.road_builder import build_road
from raw2drive_ros.simulation.roads import RoadMap
from raw2drive_ros.simulation.scenario import (
    DRAW_ATTEMPTS,
    CarSpec,
    FlowSpec,
    Scenario,
    Scene,
    TrafficSpec,
)
from raw2drive_ros.simulation.scenery import place_scenery
from raw2drive_ros.simulation.signals import Lamp
from raw2drive_ros.simulation.world_actors import WorldBuilder
from raw2drive_ros.tables.rates import DECISION_HZ, PHYSICS_HZ, SUBSTEPS

HISTORY_TICKS = 16
CHECKPOINT_SPACING_M = 25.0
ENTRY_ROOM_M = 3.0
# An ego on a detour may leave the route this much earlier, and return this much later, than the reference detour.
DETOUR_MARGIN_M = 20.0
STANDING_MPS = 0.5
# Every so many physics steps traffic is renewed.
RENEWAL_TICKS = PHYSICS_HZ // 2
# A fork knows the traffic of the next seconds, and what an ego at this speed would meet.
FORK_S, FORK_MPS = 20.0, 15.0
# Largest change of the start in repetitions of a route: along the route (m), lateral (m), speed (m/s).
START_JITTER = (1.0, 0.15, 0.5)


class World:
    """positions, headings, ...: arrays over `actors`, with the ego as the last row, rebuilt by `refresh`.

    draw: of the scene's parameters. start_rng: changes the start a little, for repetitions of a route.
    detour_offsets_m: (N,) lateral offset of the reference detour around obstacles from the route, at each point of the
    route; 0 without an obstacle. contacts: of the ego with actors so far, one per physics step and actor.
    """

    def __init__(
        self, scenario: Scenario, draw: Draw, parameters: EgoParameters | None = None, start_rng: Rng | None = None
    ) -> None:
        self.scenario = scenario
        self.draw, self.scene, self.road = _draw(scenario, draw)
        self.route = route_path(self.scene, self.road)
        self.speed_limits = speed_profile(self.route, self.scene.layout.speed_limit_mps)
        self._build_detour()
        assert self.road.surface is not None
        self.scenery = place_scenery(self.road, self.road.surface, self.draw)
        start = self.scene.route
        along, aside, faster = (0.0,) * 3 if start_rng is None else start_rng.uniform(-1.0, 1.0, 3) * START_JITTER
        self.route_s_m, self.route_lateral_m = start.start_s_m + float(along), float(aside)
        x, y, yaw = self.route.pose(self.route_s_m, self.route_lateral_m)
        speed = max(0.0, start.start_speed_mps + float(faster))
        self.ego = EgoVehicle(x, y, yaw, speed, parameters or EgoParameters())
        self.goal_s_m = self.route.end_s_m - start.end_before_m
        self.time_s = 0.0
        self.physics_ticks, self.stride = 0, 1
        self.contacts: tuple[Contact, ...] = ()
        self.decision_s = 1.0 / DECISION_HZ
        self.roster: list[object] = []
        self.is_fork = False
        self.book = CourseBook(self.road)
        self.bank = PathBank()
        self.rules = RightOfWay(self.book)
        builder = WorldBuilder(self)
        self.lights = builder.lights()
        self.light_of = {light.junction: light for light in self.lights}
        self.stop_signs = builder.stop_signs()
        self.lamp_sites = builder.lamp_sites()
        self.signs = builder.signs()
        self.ego_crossings = builder.ego_crossings()
        self.ego_stood_s = 0.0
        self._build_traffic(builder)
        self.history: deque[tuple[list[Actor], Float64]] = deque(maxlen=HISTORY_TICKS)
        self.ego_history: deque[tuple[float, float, float]] = deque(maxlen=HISTORY_TICKS)
        self.light_history: deque[tuple[str, ...]] = deque(maxlen=HISTORY_TICKS)
        self.refresh()
        self._fill()

    def _build_traffic(self, builder: WorldBuilder) -> None:
        """Actors of the scene: in the world now, or when their time or the ego comes; flows and background."""
        self.actors: list[Actor] = []
        self.next_number = 0
        self.by_number: dict[int, Actor] = {}
        self.leaving: set[int] = set()
        self.pending: list[tuple[float, Actor]] = []
        self.waiting: list[tuple[float, float, Actor]] = []
        self.flows: list[Flow] = []
        for spec in self.scene.actors:
            if isinstance(spec, FlowSpec):
                self.flows.append(builder.flow(spec, len(self.flows)))
                continue
            actor = builder.actor(spec, self.draw.rng)
            self._number(actor)
            entry = spec.enters_at_s if isinstance(spec, TrafficSpec) else 0.0
            if isinstance(spec, TrafficSpec | CarSpec) and spec.waits_for_s_m > 0.0:
                self.waiting.append((spec.waits_for_s_m, entry, actor))
            elif entry > 0.0:
                self.pending.append((entry, actor))
            else:
                self.add(actor)
        self.pending.sort(key=lambda item: item[0])
        self.waiting.sort(key=lambda item: item[0])
        spec = self.scene.background
        self.background = None if spec is None else builder.background(spec, self.flows)
        self.roadside = None if spec is None else builder.roadside(spec)
        for actor in self.roadside.actors if self.roadside else ():
            self._number(actor)

    def _fill(self) -> None:
        """The traffic that is there when the scene begins."""
        if self.roadside is not None:
            self.roadside.update(self)
        for flow in self.flows:
            flow.fill(self)
        if self.background is not None:
            self.background.fill(self)
        if self.flows or self.background is not None:
            self.history.clear()
            self.ego_history.clear()
            self.light_history.clear()
            self.refresh()

    # -- who is there -----------------------------------------------------------------------------

    def _number(self, actor: Actor) -> None:
        actor.number = self.next_number
        self.next_number += 1

    def add(self, actor: Actor) -> None:
        """Add an actor. It gets the next number, unless it has one."""
        if actor.number < 0:
            self._number(actor)
        self.actors.append(actor)
        self.by_number[actor.number] = actor

    def remove(self, actor: Actor) -> None:
        """Take an actor out of the world at the end of this step."""
        self.leaving.add(actor.number)

    def find(self, number: int) -> Actor | None:
        """The actor with a number, None once it has left."""
        return None if number in self.leaving else self.by_number.get(number)

    def ego_distance_m(self, place_m: Sequence[float] | Float64) -> float:
        """Distance of a point of `map` from the ego."""
        x, y = self.ego.position
        return math.hypot(place_m[0] - x, place_m[1] - y)

    @property
    def lamps(self) -> list[Lamp]:
        """The lamps of all approaches of all junctions with a light, the ego's among them."""
        return [Lamp(pose, light.colour_for(arm), light.junction, arm) for pose, light, arm in self.lamp_sites]

    # -- stepping ---------------------------------------------------------------------------------

    def step(self, control: Control) -> None:
        """One physics step of `stride` / PHYSICS_HZ: all actors decide on the same state, then all move.

        Vehicles decide at the decision rate, people and doors in every step.
        """
        step_worlds([self], [control])

    @property
    def decides(self) -> bool:
        """Whether vehicles decide in the coming step."""
        return self.stride >= SUBSTEPS or self.physics_ticks % SUBSTEPS == 0

    def begin(self, control: Control) -> list[PathVehicle]:
        """The first part of a step; returns the vehicles that decide in it, who need their leaders now."""
        self.ego.command = control
        self._disturb()
        return [actor for actor in self.actors if isinstance(actor, PathVehicle)] if self.decides else []

    def finish(self, vehicles: Sequence[PathVehicle]) -> None:
        """The rest of a step, once the leaders of the vehicles that decide are known."""
        dt, decides = self.stride / PHYSICS_HZ, self.decides
        if decides:
            self.rules.decide(self, vehicles)
        for actor in self.actors:
            if decides or not isinstance(actor, PathVehicle):
                actor.think(self)
        self.ego.step(dt)
        for actor in self.actors:
            actor.step(dt)
        self.physics_ticks += self.stride
        self.time_s = self.physics_ticks / PHYSICS_HZ
        self._spawn_due_traffic()
        self.contacts += resolve_contacts(self, dt)
        self.route_s_m, self.route_lateral_m = self.route.project(
            float(self.ego.position[0]), float(self.ego.position[1]), self.route_s_m
        )
        self.ego_stood_s = self.ego_stood_s + dt if abs(self.ego.speed) < STANDING_MPS else 0.0
        if self.physics_ticks // RENEWAL_TICKS != (self.physics_ticks - self.stride) // RENEWAL_TICKS:
            self._renew()
        self._let_go()
        for light in self.lights:
            light.update(self.time_s, self.front_s_m)
        for sign in self.stop_signs:
            sign.update(self.front_s_m, self.ego.speed)
        self.refresh()

    def _renew(self) -> None:
        """Traffic that goes on for ever: add what is due out of sight, remove what has left."""
        for actor in self.actors:
            beyond = isinstance(actor, PathVehicle) and not actor.leaves_in_sight and actor.s_m > actor.ends_at_s_m
            if beyond and self.ego_distance_m(actor.position) > HIDDEN_M:
                self.remove(actor)
        if self.roadside is not None:
            self.roadside.update(self)
        for flow in self.flows:
            flow.update(self)
        if self.background is not None:
            self.background.update(self)

    def _let_go(self) -> None:
        if not self.leaving and not any(actor.gone for actor in self.actors):
            return
        for actor in self.actors:
            if actor.gone or actor.number in self.leaving:
                self.by_number.pop(actor.number, None)
        self.actors = [actor for actor in self.actors if not actor.gone and actor.number not in self.leaving]
        self.leaving = set()

    def fork(self, stride: int = 1) -> World:
        """A copy that can be stepped without changing this world, for drivers that plan by simulation.

        stride: number of physics steps that one step of the fork replaces: larger is faster and coarser. Traffic that
        is not there yet is shared, and copied only when it enters the fork; what is due later than `FORK_S` is left
        out.
        """
        fork = copy.copy(self)
        fork.stride = stride
        fork.is_fork = True
        fork.ego = copy.copy(self.ego)
        fork.ego.position = self.ego.position.copy()
        fork.actors = [fork_of(actor) for actor in self.actors]
        fork.by_number = {actor.number: actor for actor in fork.actors}
        fork.leaving = set(self.leaving)
        fork.pending = [entry for entry in self.pending if entry[0] < self.time_s + FORK_S]
        fork.waiting = [entry for entry in self.waiting if entry[0] < self.route_s_m + FORK_S * FORK_MPS]
        fork.flows = [flow.fork() for flow in self.flows]
        fork.background = self.background and self.background.fork()
        fork.roadside = self.roadside and self.roadside.fork()
        fork.lights = [copy.copy(light) for light in self.lights]
        fork.light_of = {light.junction: light for light in fork.lights}
        fork.lamp_sites = [(pose, fork.light_of[light.junction], arm) for pose, light, arm in self.lamp_sites]
        fork.stop_signs = [copy.copy(sign) for sign in self.stop_signs]
        fork.history = deque(maxlen=1)
        fork.ego_history, fork.light_history = deque(maxlen=1), deque(maxlen=1)
        fork.roster = []
        fork.refresh()
        return fork

    def _spawn_due_traffic(self) -> None:
        """Add traffic whose time has come, one vehicle after another, each once its place is free."""
        if self.waiting and self.route_s_m >= self.waiting[0][0]:
            reached = [entry for entry in self.waiting if self.route_s_m >= entry[0]]
            self.waiting = self.waiting[len(reached) :]
            self.pending += [(self.time_s + after_s, actor) for _, after_s, actor in reached]
            self.pending.sort(key=lambda entry: entry[0])
        while self.pending and self.time_s >= self.pending[0][0]:
            actor = self.pending[0][1]
            room = actor.LENGTH + ENTRY_ROOM_M
            if any(np.abs(other.position - actor.position).max() <= room for other in (*self.actors, self.ego)):
                return
            # The actor of a fork must not change: it belongs to the world that was forked.
            self.add(fork_of(actor) if self.is_fork else actor)
            del self.pending[0]

    def _disturb(self) -> None:
        self.ego.steer_push, self.ego.grip = 0.0, 1.0
        for patch in self.scene.disturbances:
            if patch.s_m <= self.route_s_m < patch.s_m + patch.length_m:
                side = 1.0 if self.time_s // patch.period_s % 2 else -1.0
                self.ego.steer_push, self.ego.grip = side * patch.steer, patch.grip

    @property
    def front_s_m(self) -> float:
        """Arc length of the ego's front bumper on the route."""
        return self.route_s_m + self.ego.LENGTH / 2

    def speed_limit_at(self, s_m: float) -> float:
        return float(self.speed_limits[self.route.index_at(s_m)])

    def detour_offset_m(self, s_m: float) -> float:
        """Lateral offset of the reference detour from the route at `s_m`, left positive."""
        return float(self.detour_offsets_m[self.route.index_at(s_m)])

    def detour_window(self, s_m: float, ahead_m: float) -> Float64:
        """(M, 2) points of the reference detour from `s_m` to `s_m + ahead_m` of the route, 1 m apart."""
        first = self.route.index_at(s_m)
        return self.detour_points_m[first : first + int(ahead_m / SPACING_M) : 2]

    def lateral_range_m(self, s_m: float) -> tuple[float, float]:
        """(right, left) offsets from the route between which the ego's centre may be; (0, 0) away from detours."""
        for begin, end, offset in self.detours:
            if begin - DETOUR_MARGIN_M < s_m < end + DETOUR_MARGIN_M:
                return min(0.0, offset), max(0.0, offset)
        return 0.0, 0.0

    def checkpoints_m(self) -> Float64:
        """(N, 2) checkpoints for the driver: a point of the route every `CHECKPOINT_SPACING_M`, and the goal."""
        stations = np.append(np.arange(0.0, self.goal_s_m, CHECKPOINT_SPACING_M), self.goal_s_m)
        return np.array([self.route.pose(float(s))[:2] for s in stations])

    def index_of(self, actor: Actor) -> int:
        return self._index[id(actor)]

    def refresh(self) -> None:
        """Rebuild the arrays over `actors` and the ego, and add poses and light colours to the histories.

        `step` and `fork` call it. Call it yourself after you changed `actors`, or moved an actor or the ego, by hand.
        Every call adds one entry to the histories, so the BEV masks see it as one more physics step.
        """
        everything = [*self.actors, self.ego]
        if self.roster != everything:
            self.roster = everything
            self._index = {id(actor): i for i, actor in enumerate(everything)}
            self.half_widths = np.array([a.WIDTH / 2 for a in everything])
            self.half_lengths = np.array([a.LENGTH / 2 for a in everything])
            self.walks = np.array([isinstance(a, Walker) for a in everything])
        self.positions = np.array([a.position for a in everything])
        self.headings = np.array([a.heading for a in everything])
        self.speeds = np.array([a.speed for a in everything])
        poses = np.column_stack([self.positions, self.headings])
        self.history.appendleft((list(self.actors), poses[:-1]))
        self.ego_history.appendleft((poses[-1, 0], poses[-1, 1], poses[-1, 2]))
        self.light_history.appendleft(tuple(light.colour for light in self.lights))

    # -- building ---------------------------------------------------------------------------------

    def _build_detour(self) -> None:
        spec = self.scene.route
        stations = [self.route.station(i) for i in range(len(self.route.points_m))]
        width = self.scene.layout.lane_width_m
        self.detour_offsets_m = np.array([offset_m(spec.lane, spec.lane, spec.detour, s, width) for s in stations])
        yaw = self.route.headings_rad
        self.detour_points_m = self.route.points_m + self.detour_offsets_m[:, None] * np.stack(
            [-np.sin(yaw), np.cos(yaw)], 1
        )
        # (start, end, lateral offset) of each detour: from the lane change away from the route to the one back, if any.
        self.detours: list[tuple[float, float, float]] = []
        for i, out in enumerate(spec.detour):
            if out.to_lane == spec.lane:
                continue
            back = spec.detour[i + 1] if i + 1 < len(spec.detour) else None
            end = self.route.length_m if back is None else back.s_m + back.over_m
            self.detours.append((out.s_m, end, -(out.to_lane - spec.lane) * width))


def step_worlds(worlds: Sequence[World], controls: Sequence[Control]) -> None:
    """Step several worlds at once: the same as one after the other, in less time."""
    groups = [(world, world.begin(control)) for world, control in zip(worlds, controls, strict=True)]
    find_leaders_in(groups)
    for world, vehicles in groups:
        world.finish(vehicles)


def _draw(scenario: Scenario, draw: Draw) -> tuple[Draw, Scene, RoadMap]:
    """Draw scenes until one belongs to its split and its road does not overlap itself."""
    for _ in range(DRAW_ATTEMPTS):
        try:
            scene = scenario.draw(draw)
            if draw.is_of_its_split():
                return draw, scene, build_road(scene.layout)
        except LayoutError:
            pass
        draw = draw.again()
    raise LayoutError(f'{scenario.name}: no drivable layout of {draw.split} in {DRAW_ATTEMPTS} draws')
