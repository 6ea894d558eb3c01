"""The world of one episode: built from a `Scene`, stepped at the physics rate. No images, no reward."""

from __future__ import annotations

import copy
import math
from collections import deque

import numpy as np

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.contracts.public import Control, Float64
from raw2drive_ros.simulation.actors import Actor, CarDoor, Look, PathVehicle, StandingObject, Walker, fork_of
from raw2drive_ros.simulation.contact import Contact, resolve_contacts
from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.ego import EgoParameters, EgoVehicle
from raw2drive_ros.simulation.layout import LANE_WIDTH_M
from raw2drive_ros.simulation.leaders import find_leaders
from raw2drive_ros.simulation.path import SPACING_M, Path, smooth_step
from raw2drive_ros.simulation.road_builder import build_road
from raw2drive_ros.simulation.roads import ARM_TURN_RAD, RoadMap
from raw2drive_ros.simulation.scenario import (
    DRAW_ATTEMPTS,
    ActorSpec,
    DoorSpec,
    LaneChange,
    LightSpec,
    Scenario,
    Scene,
    StandingSpec,
    TrafficSpec,
    WalkerSpec,
)
from raw2drive_ros.simulation.scripts import Meeting
from raw2drive_ros.simulation.signals import StopSign, TrafficLight
from raw2drive_ros.tables.rates import PHYSICS_HZ

HISTORY_TICKS = 16
CURVE_LATERAL_MPS2 = 3.0
CURVE_BRAKING_MPS2 = 2.0
CHECKPOINT_SPACING_M = 25.0
ENTRY_ROOM_M = 3.0
# An ego on a detour may leave the route this much earlier, and return this much later, than the reference detour.
DETOUR_MARGIN_M = 20.0
STRAIGHT_1PM = 1e-3
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
        rng = draw.rng
        self.route = _route_path(self.scene, self.road)
        self.speed_limits = _speed_profile(self.route, self.scene.layout.speed_limit_mps)
        self._build_detour()
        start = self.scene.route
        along, aside, faster = (0.0,) * 3 if start_rng is None else start_rng.uniform(-1.0, 1.0, 3) * START_JITTER
        self.route_s_m, self.route_lateral_m = start.start_s_m + float(along), float(aside)
        x, y, yaw = self.route.pose(self.route_s_m, self.route_lateral_m)
        speed = max(0.0, start.start_speed_mps + float(faster))
        self.ego = EgoVehicle(x, y, yaw, speed, parameters or EgoParameters())
        self.goal_s_m = self.route.length_m - start.end_before_m
        self.time_s = 0.0
        self.physics_ticks, self.stride = 0, 1
        self.contacts: tuple[Contact, ...] = ()
        self.lights = [self._light(spec) for spec in self.scene.lights]
        self.stop_signs = [self._stop_sign(spec.junction) for spec in self.scene.stop_signs]
        self.actors: list[Actor] = []
        self.paths: dict[tuple[object, int, int], Path] = {}
        self.pending: list[tuple[float, Actor]] = []
        self.waiting: list[tuple[float, float, Actor]] = []
        for spec in self.scene.actors:
            actor = self._actor(spec, rng)
            if isinstance(spec, TrafficSpec) and spec.waits_for_s_m > 0.0:
                self.waiting.append((spec.waits_for_s_m, spec.enters_at_s, actor))
            elif isinstance(spec, TrafficSpec) and spec.enters_at_s > 0.0:
                self.pending.append((spec.enters_at_s, actor))
            else:
                self.actors.append(actor)
        self.pending.sort(key=lambda entry: entry[0])
        self.waiting.sort(key=lambda entry: entry[0])
        self.history: deque[tuple[list[Actor], Float64]] = deque(maxlen=HISTORY_TICKS)
        self.ego_history: deque[tuple[float, float, float]] = deque(maxlen=HISTORY_TICKS)
        self.light_history: deque[tuple[str, ...]] = deque(maxlen=HISTORY_TICKS)
        self.refresh()

    # -- stepping ---------------------------------------------------------------------------------

    def step(self, control: Control) -> None:
        """One physics step of `stride` / PHYSICS_HZ: all actors decide on the same state, then all move."""
        dt = self.stride / PHYSICS_HZ
        self.ego.command = control
        self._disturb()
        find_leaders(self, [a for a in self.actors if isinstance(a, PathVehicle)])
        for actor in self.actors:
            actor.think(self)
        self.ego.step(dt)
        for actor in self.actors:
            actor.step(dt)
        self.physics_ticks += self.stride
        self.time_s = self.physics_ticks / PHYSICS_HZ
        self.actors = [actor for actor in self.actors if not actor.gone]
        self._spawn_due_traffic()
        self.contacts += resolve_contacts(self, dt)
        self.route_s_m, self.route_lateral_m = self.route.project(
            float(self.ego.position[0]), float(self.ego.position[1]), self.route_s_m
        )
        for light in self.lights:
            light.update(self.time_s, self.front_s_m)
        for sign in self.stop_signs:
            sign.update(self.front_s_m, self.ego.speed)
        self.refresh()

    def fork(self, stride: int = 1) -> World:
        """A copy that can be stepped without changing this world, for drivers that plan by simulation.

        stride: number of physics steps that one step of the fork replaces: larger is faster and coarser.
        """
        fork = copy.copy(self)
        fork.stride = stride
        fork.ego = copy.copy(self.ego)
        fork.ego.position = self.ego.position.copy()
        fork.actors = [fork_of(actor) for actor in self.actors]
        fork.pending = [(time_s, fork_of(actor)) for time_s, actor in self.pending]
        fork.waiting = [(s_m, time_s, fork_of(actor)) for s_m, time_s, actor in self.waiting]
        fork.lights = [copy.copy(light) for light in self.lights]
        fork.stop_signs = [copy.copy(sign) for sign in self.stop_signs]
        fork.history = deque(maxlen=1)
        fork.ego_history, fork.light_history = deque(maxlen=1), deque(maxlen=1)
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
            self.actors.append(actor)
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
        index = min(max(int(s_m * 2), 0), len(self.speed_limits) - 1)
        return float(self.speed_limits[index])

    def detour_offset_m(self, s_m: float) -> float:
        """Lateral offset of the reference detour from the route at `s_m`, left positive."""
        index = min(max(int(s_m / SPACING_M), 0), len(self.detour_offsets_m) - 1)
        return float(self.detour_offsets_m[index])

    def detour_window(self, s_m: float, ahead_m: float) -> Float64:
        """(M, 2) points of the reference detour from `s_m` to `s_m + ahead_m` of the route, 1 m apart."""
        first = max(0, int(s_m / SPACING_M))
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
        self._index = {id(actor): i for i, actor in enumerate(everything)}
        self.positions = np.array([a.position for a in everything])
        self.headings = np.array([a.heading for a in everything])
        self.speeds = np.array([a.speed for a in everything])
        self.half_widths = np.array([a.WIDTH / 2 for a in everything])
        self.half_lengths = np.array([a.LENGTH / 2 for a in everything])
        poses = np.column_stack([self.positions, self.headings])
        self.history.appendleft((list(self.actors), poses[:-1]))
        self.ego_history.appendleft((poses[-1, 0], poses[-1, 1], poses[-1, 2]))
        self.light_history.appendleft(tuple(light.colour for light in self.lights))

    # -- building ---------------------------------------------------------------------------------

    def _build_detour(self) -> None:
        spec = self.scene.route
        stations = range(len(self.route.points_m))
        self.detour_offsets_m = np.array(
            [_offset_m(spec.lane, spec.lane, spec.detour, i * SPACING_M) for i in stations]
        )
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
            self.detours.append((out.s_m, end, -(out.to_lane - spec.lane) * LANE_WIDTH_M))

    def _light(self, spec: LightSpec) -> TrafficLight:
        entry, pole = self._junction_entry(spec.junction, beyond=True)
        return TrafficLight(entry, spec.phases, spec.trigger_m, pole)

    def _stop_sign(self, junction: int) -> StopSign:
        entry, pole = self._junction_entry(junction, beyond=False)
        return StopSign(entry, pole)

    def _junction_entry(self, junction: int, *, beyond: bool) -> tuple[float, tuple[float, float, float]]:
        """(arc length of the stop line on the route, pose of a pole right of the road before or after the junction)."""
        site = self.road.junctions[junction]
        cos, sin = math.cos(site.heading_rad), math.sin(site.heading_rad)
        back = -site.half_size_m
        x, y = site.centre_m[0] + back * cos, site.centre_m[1] + back * sin
        line_s, _ = self.route.project(x, y)
        along = site.half_size_m + 1.0 if beyond else back - 1.0
        aside = -(self.scene.layout.forward_lanes * LANE_WIDTH_M + 1.5)
        pole = (
            site.centre_m[0] + along * cos - aside * sin,
            site.centre_m[1] + along * sin + aside * cos,
            site.heading_rad + math.pi,
        )
        return line_s - 0.6, pole

    def _actor(self, spec: ActorSpec, rng: Rng) -> Actor:
        look = Look.draw('door' if isinstance(spec, DoorSpec) else spec.kind, rng)
        if isinstance(spec, WalkerSpec):
            return Walker(self.route, spec.s_m, spec.from_m, spec.to_m, spec.speed_mps, spec.delay_s, spec.kind, look)
        if isinstance(spec, DoorSpec):
            return CarDoor(self.route, spec.s_m, spec.hinge_m, spec.trigger_m, look)
        if isinstance(spec, StandingSpec):
            x, y, yaw = self.route.pose(spec.s_m, spec.lateral_m)
            return StandingObject(x, y, yaw + spec.yaw_rad, spec.kind, look)
        path = self._traffic_path(spec)
        waits = ()
        number = next((i for i, light in enumerate(self.scene.lights) if light.junction == spec.junction), None)
        if spec.obeys_light and number is not None:
            crosses = isinstance(spec.on, tuple) and spec.on[0] in ('left', 'right')
            entry = self._stop_line_s_m(spec, path)
            open_at = 'red' if crosses else 'green'
            waits = ((entry, lambda world: world.lights[number].colour != open_at),)
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
            steered=self._meeting(spec, path) if spec.meets_ego else spec.pacing,
            has_priority=spec.has_priority,
            time_gap_s=spec.time_gap_s,
            ends_at_s_m=spec.ends_at_s_m,
        )

    def _meeting(self, spec: TrafficSpec, path: Path) -> Meeting:
        """Conflict point of a vehicle and the ego: the closest pair of points on their paths within the junction."""
        site = self.road.junctions[spec.junction]
        reach = site.half_size_m + 2.0
        own, ego = (np.abs(p.points_m - site.centre_m).max(axis=1) < reach for p in (path, self.route))
        own_at, ego_at = np.flatnonzero(own), np.flatnonzero(ego)
        gaps = path.points_m[own_at, None] - self.route.points_m[None, ego_at]
        i, j = np.unravel_index(np.argmin(np.einsum('abk,abk->ab', gaps, gaps)), (len(own_at), len(ego_at)))
        return Meeting(float(own_at[i]) * SPACING_M, float(ego_at[j]) * SPACING_M)

    def _stop_line_s_m(self, spec: TrafficSpec, path: Path) -> float:
        """Arc length of a vehicle's stop line before junction `spec.junction`, on its path."""
        site = self.road.junctions[spec.junction]
        arm = spec.on[0] if isinstance(spec.on, tuple) else 'back'
        yaw = site.heading_rad + (math.pi if arm == 'back' else ARM_TURN_RAD[arm])
        x = site.centre_m[0] + (site.half_size_m + 0.6) * math.cos(yaw)
        y = site.centre_m[1] + (site.half_size_m + 0.6) * math.sin(yaw)
        return path.project(x, y)[0]

    def _traffic_path(self, spec: TrafficSpec) -> Path:
        """The path of a vehicle. Vehicles share `Path` objects, which is how `find_leaders` groups them."""
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


def _route_path(scene: Scene, road: RoadMap) -> Path:
    spec = scene.route
    if spec.from_ramp:
        return road.ramp_path()
    base = min(round(spec.lane), scene.layout.forward_lanes - 1)
    path = road.forward_path(base)
    for change in (*spec.changes, *spec.detour):
        if path.curvature(change.s_m, change.over_m) > STRAIGHT_1PM:
            raise ValueError(f'RouteSpec: lane changes need straight road, here at {change.s_m:.0f} m')
    if not spec.changes:
        return path
    shifted = path.shifted(lambda s_m: _offset_m(spec.lane, base, spec.changes, s_m))
    if not spec.to_exit:
        return shifted
    away = road.exit_path()
    end_s_m, _ = shifted.project(float(away.points_m[0, 0]), float(away.points_m[0, 1]))
    return Path(np.concatenate([shifted.points_m[: int(end_s_m / SPACING_M)], away.points_m]))


def _offset_m(start_lane: float, base_lane: float, changes: tuple[LaneChange, ...], s_m: float) -> float:
    """Lateral offset (left positive) from lane `base_lane` after starting in `start_lane` and making `changes`."""
    lane, offset = start_lane, -(start_lane - base_lane) * LANE_WIDTH_M
    for change in changes:
        offset -= (change.to_lane - lane) * LANE_WIDTH_M * smooth_step(s_m, change.s_m, change.over_m)
        lane = change.to_lane
    return offset


def _speed_profile(route: Path, limit_mps: float) -> Float64:
    """Advised speed (m/s) every 0.5 m: the limit, reduced in curves and on the braking distance before them."""
    headings = route.headings_rad
    curvature = np.abs(np.gradient(headings, 0.5))
    kernel = np.ones(9) / 9
    curvature = np.convolve(np.pad(curvature, 4, mode='edge'), kernel, mode='valid')
    speed = np.minimum(limit_mps, np.sqrt(CURVE_LATERAL_MPS2 / np.maximum(curvature, 1e-3)))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2 * CURVE_BRAKING_MPS2 * 0.5))
    return speed
