"""One decision's view of the ego's own lane: where it is, what it may do there, and what lies in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_belief import SOFT, STANDING_MPS, Belief
from raw2drive_ros.evaluation.expert_map import FORWARD, ONCOMING, LaneMap, RouteFrame, poses_at
from raw2drive_ros.evaluation.expert_prediction import Forecast
from raw2drive_ros.evaluation.expert_rules import RightOfWay
from raw2drive_ros.simulation.world import World

BEHIND_M, AHEAD_M = 60.0, 140.0
GRID_BEHIND_M, GRID_M = 6.0, 1.0
HALF_WIDTH_M, HALF_LENGTH_M = 1.0, 2.4
# Clearance to fixed things and to people that a path past them has.
CLEAR_M, CLEAR_SOFT_M = 0.55, 0.9
# Obstacles closer together than this are passed in one go.
JOINED_M = 14.0
BLOCKED_AFTER_S = 25.0
SLOW_SHARE = 0.45
BLOCKS_WITHIN_M, JUNCTION_M = 85.0, 25.0
SIGNAL_STOP_MPS2, LATE_MPS2, LINE_SHORT_M = 3.2, 6.5, 0.8


@dataclass(frozen=True, slots=True)
class Zone:
    """A stretch of the route that something blocks. d_low, d_high: its lateral extent. speed: along the route."""

    begin_m: float
    end_m: float
    d_low: float
    d_high: float
    speed: float
    soft: bool
    name: str


@dataclass(frozen=True, slots=True)
class Anchor:
    """Where a shift to the side began: arc length, offset, slope, and its length. stations, target: where it leads."""

    s_m: float
    d_m: float
    slope: float
    over_m: float
    stations: Float64
    target: Float64


@dataclass(slots=True)
class Situation:
    """grid: (G,) arc lengths of the route around the ego. limit: (G,) advised speed there."""

    world: World
    lanes: LaneMap
    belief: Belief
    rules: RightOfWay
    frame: RouteFrame
    s: float
    d: float
    slope: float
    speed: float
    grid: Float64
    limit: Float64
    forecast: Forecast
    anchor: Anchor | None = None

    @property
    def front_m(self) -> float:
        return self.s + HALF_LENGTH_M

    @property
    def advised_mps(self) -> float:
        return float(np.interp(self.s, self.grid, self.limit))


def own_state(world: World, frame: RouteFrame) -> tuple[float, float, float, float]:
    """(arc length, lateral offset, slope of the lateral offset, speed) of the ego along its route."""
    ego = world.ego
    s, d, yaw = frame.project(np.array([float(ego.position[0])]), np.array([float(ego.position[1])]))
    course = ego.heading + ego.beta_rad
    slope = math.tan(min(max(math.remainder(course - float(yaw[0]), 2.0 * math.pi), -0.7), 0.7))
    return float(s[0]), float(d[0]), slope, max(float(ego.speed), 0.0)


def limits_on(world: World, grid: Float64) -> Float64:
    """(G,) advised speed (m/s) at stations of the route."""
    return np.array([world.speed_limit_at(float(s)) for s in grid])


def stop_line(situation: Situation) -> tuple[float, str]:
    """(arc length at which the front bumper has to stop, why), for lights and stop signs that were seen; or inf."""
    world, front, best, why = situation.world, situation.front_m, math.inf, ''
    for i, light in enumerate(world.lights):
        gap = light.line_s_m - front
        if gap < -0.4 or light.line_s_m > best:
            continue
        colour = situation.belief.colour(i)
        if colour is None or colour == 'green':
            continue
        needed = situation.speed**2 / (2.0 * max(gap - 0.2, 0.2))
        if needed > (SIGNAL_STOP_MPS2 if colour == 'yellow' else LATE_MPS2) and situation.speed > 2.0:
            continue
        best, why = light.line_s_m, f'{colour} light'
    for i, sign in enumerate(world.stop_signs):
        if i in situation.belief.signs and not sign.obeyed and front - 0.4 < sign.line_s_m < best:
            best, why = sign.line_s_m, 'stop sign'
    return best - LINE_SHORT_M, why


def zones(situation: Situation) -> list[Zone]:
    """What blocks the ego's route ahead and will not go away: obstacles, wrecks, slow cyclists; nearest first."""
    view, found = situation.forecast, []
    seen: set[int] = set()
    for i, h in enumerate(view.hypotheses):
        track = h.track
        if track.number in seen:
            continue
        seen.add(track.number)
        ahead = float(view.s[i, 0]) - situation.s
        if not -6.0 < ahead < BLOCKS_WITHIN_M:
            continue
        along = track.speed * math.cos(float(view.turned[i, 0]))
        standing = track.fixed or (track.standing_s > BLOCKED_AFTER_S and track.speed < STANDING_MPS)
        rides = track.kind == 'cyclist' and 0.5 < along < SLOW_SHARE * situation.advised_mps
        # Nobody is overtaken at a junction.
        rides = rides and not _near_junction(situation, float(view.s[i, 0]))
        if not (standing or rides):
            continue
        d, half = float(view.d[i, 0]), float(view.half_d[i, 0])
        if abs(d) - half > HALF_WIDTH_M + 0.3:
            continue
        s, reach = float(view.s[i, 0]), float(view.half_s[i, 0])
        found.append(Zone(s - reach, s + reach, d - half, d + half, along, track.kind in SOFT, track.name))
    return _joined(sorted(found, key=lambda zone: zone.begin_m))


def _near_junction(situation: Situation, s_m: float) -> bool:
    return any(enter - JUNCTION_M < s_m < leave + 5.0 for enter, leave, _ in situation.lanes.spans)


def _joined(found: list[Zone]) -> list[Zone]:
    joined: list[Zone] = []
    for zone in found:
        if joined and zone.begin_m - joined[-1].end_m < JOINED_M:
            last = joined[-1]
            joined[-1] = Zone(
                last.begin_m,
                max(last.end_m, zone.end_m),
                min(last.d_low, zone.d_low),
                max(last.d_high, zone.d_high),
                min(last.speed, zone.speed),
                last.soft or zone.soft,
                last.name,
            )
        else:
            joined.append(zone)
    return joined


def lane_kind(situation: Situation, s_m: float, side: int) -> int:
    """FORWARD, ONCOMING or NOTHING beside the route at `s_m`."""
    return situation.lanes.lane_beside(s_m, side)


def conflict_stops(situation: Situation) -> list[tuple[float, str]]:
    """[(arc length for the front bumper, name)] of places to wait at for whoever crosses the route; nearest first."""
    view = situation.forecast
    touching = (np.abs(view.d) < view.half_d + HALF_WIDTH_M + 0.5) & (view.s > situation.front_m - 1.0)
    moving = view.speed[:, :1] > 0.3
    across = np.abs(np.sin(view.turned)) > 0.3
    oncoming = np.cos(view.turned) < -0.5
    touching &= (across | oncoming) & moving
    found: list[tuple[float, str]] = []
    rows = np.flatnonzero(touching.any(axis=1))
    for row in rows.tolist():
        at = float(np.where(touching[row], view.s[row] - view.half_s[row], np.inf).min())
        found.append((_waiting_place(situation, at), view.hypotheses[row].track.name))
    found = [(at, name) for at, name in found if at > situation.front_m + 0.3]
    distinct: list[tuple[float, str]] = []
    for at, name in sorted(found):
        if not distinct or at - distinct[-1][0] > 3.0:
            distinct.append((at, name))
    return distinct[:2]


def _waiting_place(situation: Situation, at_m: float) -> float:
    """Where to wait for a conflict at `at_m`: before the junction that it lies in, if the ego is not in it yet."""
    for enter, leave, _ in situation.lanes.spans:
        if enter - 2.0 < at_m < leave + 4.0 and situation.front_m < enter + 0.3:
            return enter - 0.7
    return at_m - 2.2


def lane_profile(situation: Situation, side: int) -> tuple[Float64, float] | None:
    """((G,) lateral offset from the route of the lane `side` lanes left of the ego, where that lane ends), or None.

    side 0: the lane that the ego is in.
    """
    world, lanes = situation.world, situation.lanes
    here = lanes.places(np.array([[*map(float, world.ego.position), world.ego.heading]]))[0]
    if not here:
        return None
    lane = lanes.lanes[here[0].lane]
    pose = lane.pose(here[0].s_m, side * lanes.width_m)
    places = lanes.places(np.array([pose]))[0]
    places = [place for place in places if abs(place.lateral_m) < 0.6]
    if not places:
        return None
    best: tuple[Float64, float] | None = None
    for way in lanes.continuations(places[0].lane, AHEAD_M):
        along = np.arange(max(0.0, places[0].s_m - GRID_BEHIND_M), way.path.length_m, 2.0)
        along = along[along < places[0].s_m + AHEAD_M]
        if len(along) < 2:
            continue
        x, y, _ = poses_at(way.path, along)
        s, d, _ = situation.frame.project(x, y)
        keep = np.concatenate(([True], np.diff(s) > 0.5))
        s, d = s[keep], d[keep]
        profile = np.interp(situation.grid, s, d)
        ends = float(s[-1]) if way.path.length_m < places[0].s_m + AHEAD_M - 2.0 else math.inf
        if best is None or np.abs(profile).mean() < np.abs(best[0]).mean():
            best = profile, ends
    return best


def is_oncoming(situation: Situation, s_m: float, d_m: float) -> bool:
    """Whether a car at that place of the route reaches into a lane of oncoming traffic."""
    side = round((d_m + math.copysign(HALF_WIDTH_M, d_m)) / situation.lanes.width_m)
    return side != 0 and lane_kind(situation, s_m, int(math.copysign(min(abs(side), 2), side))) == ONCOMING


def is_forward(situation: Situation, s_m: float, side: int) -> bool:
    """Whether a lane in the ego's direction runs `side` lanes to the left of the route."""
    return lane_kind(situation, s_m, side) == FORWARD
