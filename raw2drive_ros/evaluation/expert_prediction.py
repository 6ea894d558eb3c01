"""Where others may go in the next seconds: hypotheses per actor, as arrays over time.

Cars follow their lane, each way through the next junction that their indicator allows, with IDM behind the next one in
their lane; whoever has to stop for the ego's right of way does so unless it is too fast for it. Whoever is off the
lanes, walks or rides across keeps speed and heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_belief import Belief, Track
from raw2drive_ros.evaluation.expert_map import Continuation, LaneMap, Place, RouteFrame, poses_at
from raw2drive_ros.evaluation.expert_rules import RightOfWay
from raw2drive_ros.simulation.path import Path

DT_S = 0.3
# A hypothesis below this weight is only feared: it counts once it is nearly too late to stop for it.
LIKELY = 0.5
IDM_ACCELERATION_MPS2, IDM_BRAKING_MPS2, IDM_TIME_GAP_S, IDM_GAP_M = 2.0, 3.0, 1.0, 2.5
# An estimated acceleration is taken to go on for this long; braking goes on to the stop.
ACCELERATES_FOR_S, BRAKES_MPS2 = 0.8, -1.0
DRIFT_RAD, DRIFT_MPS = 0.035, 0.25
# Somebody who must stop is expected to do so if this deceleration is enough.
STOPS_WITH_MPS2, SURE_MPS2 = 4.0, 2.5
REACH_MARGIN_M = 25.0
INDICATES_DRIFT_S, SWERVES_FOR_S, CUTS_IN_S, FAST_WEIGHT = 3.0, 0.8, 1.3, 0.7
TURN_SPEED_MPS = 7.0
WATCHED_M, WATCHED_STANDING_M = 110.0, 85.0
# Cars that turn indicate it from this distance on; one that is slower than this so close before a junction may turn.
INDICATES_M, SLOW_BEFORE_M, SLOW_MPS = 40.0, 15.0, 4.5


@dataclass(slots=True)
class Hypothesis:
    """One way an actor may go. path: with its place on it, or None to go straight. lateral_m, to_lateral_m: from the
    path, now and where a drift ends, with `drift_mps`. stop_m: distance at which it is expected to stop."""

    track: Track
    weight: float
    path: Path | None = None
    s_m: float = 0.0
    lateral_m: float = 0.0
    to_lateral_m: float = 0.0
    drift_mps: float = 0.0
    stop_m: float = math.inf
    slow_from_m: float = math.inf
    leader: int = -1
    gap_m: float = math.inf
    offsets: dict[int, float] | None = None


@dataclass(slots=True)
class Forecast:
    """Arrays over hypotheses (N) and times (T). s, d, turned: arc length, lateral offset and heading relative to the
    ego's route. half_s, half_d: half extents along and across the route."""

    times_s: Float64
    hypotheses: list[Hypothesis]
    x: Float64
    y: Float64
    yaw: Float64
    speed: Float64
    s: Float64
    d: Float64
    turned: Float64
    half_s: Float64
    half_d: Float64
    length: Float64
    width: Float64
    weight: Float64


def hypotheses(
    belief: Belief, lanes: LaneMap, rules: RightOfWay, horizon_s: float, ego_xy: tuple[float, float]
) -> list[Hypothesis]:
    """All hypotheses about all tracks near the ego; the first one of each track is the likeliest."""
    tracks = [t for t in belief.tracks.values() if math.hypot(t.x - ego_xy[0], t.y - ego_xy[1]) < _watched_m(t)]
    places = lanes.places(np.array([(t.x, t.y, t.yaw) for t in tracks]).reshape(-1, 3))
    found: list[Hypothesis] = []
    for track, where in zip(tracks, places, strict=True):
        if track.fixed or track.kind == 'walker' or not where:
            found.append(Hypothesis(track, 1.0))
            continue
        found += _on_lanes(track, where, lanes, rules, horizon_s)
    _find_leaders(found, {t.number: w for t, w in zip(tracks, places, strict=True)})
    return found


def _watched_m(track: Track) -> float:
    """Distance (m) within which a track can matter in the next seconds."""
    return WATCHED_STANDING_M if track.fixed or track.kind == 'walker' else WATCHED_M


def _on_lanes(
    track: Track, where: list[Place], lanes: LaneMap, rules: RightOfWay, horizon_s: float
) -> list[Hypothesis]:
    found: list[Hypothesis] = []
    reach = track.speed * horizon_s + REACH_MARGIN_M
    for place in where:
        ways = lanes.continuations(place.lane, reach)
        for way in ways:
            weight = _weight(track, place, way, ways, alone=len(where) == 1)
            if weight <= 0.0:
                continue
            hypothesis = Hypothesis(track, weight, way.path, place.s_m, place.lateral_m, offsets=way.offsets_m)
            _drift(hypothesis, place, lanes)
            _slow_for_turn(hypothesis, place, way)
            found += _with_right_of_way(hypothesis, place, way, rules)
            found += _cuts_in(hypothesis)
    if not found:
        return [Hypothesis(track, 1.0)]
    top = max(h.weight for h in found)
    for hypothesis in found:
        hypothesis.weight /= top
    if track.kind == 'cyclist' or abs(where[0].error_rad) > 0.35:
        found.append(Hypothesis(track, 0.6))
    return sorted(found, key=lambda h: -h.weight)


def _weight(track: Track, place: Place, way: Continuation, ways: list[Continuation], *, alone: bool) -> float:
    """Likelihood of one way on, by indicator, heading and whether it goes straight on."""
    weight = 1.0 if alone else math.exp(-((place.lateral_m / 0.6) ** 2) - (place.error_rad / 0.15) ** 2)
    ahead = [c for c in way.crossings if c[2] > place.s_m]
    if not ahead or ahead[0][1] <= place.s_m:
        return weight if weight > 0.02 else 0.0
    turn = ahead[0][3]
    left_m = ahead[0][1] - place.s_m
    wanted = track.indicator or 'ahead'
    if turn == wanted:
        return weight
    if track.indicator and left_m < INDICATES_M:
        return 0.0
    if turn == 'ahead':
        return 0.3 * weight
    # Without an indicator a turn is unlikely, but where the road does not go straight on or the car slows down for it.
    straight = any(other.crossings and other.crossings[0][3] == 'ahead' for other in ways)
    slows = left_m < SLOW_BEFORE_M and track.speed < SLOW_MPS
    return weight if not straight else 0.1 * weight if slows else 0.0


def _drift(hypothesis: Hypothesis, place: Place, lanes: LaneMap) -> None:
    """Lateral motion relative to the lane: goes on to the middle of a lane, of the next one if it leads there."""
    track, width = hypothesis.track, lanes.width_m
    hypothesis.to_lateral_m = place.lateral_m
    across = track.speed * math.sin(place.error_rad)
    if lanes.lanes[place.lane].junction >= 0 or abs(place.error_rad) < DRIFT_RAD or abs(across) < DRIFT_MPS:
        if track.indicator and track.speed > 1.0 and not any(lanes.lanes[i].junction >= 0 for i in _next(lanes, place)):
            side = 1.0 if track.indicator == 'left' else -1.0
            hypothesis.to_lateral_m = side * width
            hypothesis.drift_mps = side * width / INDICATES_DRIFT_S
        return
    side = math.copysign(1.0, across)
    if place.lateral_m * side < -0.2:
        hypothesis.to_lateral_m = 0.0
    elif lanes.has_lane_beside(place, round(side)):
        hypothesis.to_lateral_m = side * width
    else:
        # Nobody changes into the lane of oncoming traffic or onto the verge: it cuts a curve or swerves.
        hypothesis.to_lateral_m = place.lateral_m + SWERVES_FOR_S * across
    hypothesis.drift_mps = across


def _next(lanes: LaneMap, place: Place) -> list[int]:
    return lanes.successors[place.lane]


def _cuts_in(hypothesis: Hypothesis) -> list[Hypothesis]:
    """A car that moves towards another lane may do so within a moment."""
    across = hypothesis.to_lateral_m - hypothesis.lateral_m
    if hypothesis.drift_mps == 0.0 or abs(across) < 1.5 or hypothesis.track.speed < 1.0:
        return []
    fast = replace(hypothesis, weight=FAST_WEIGHT * hypothesis.weight)
    fast.drift_mps = across / CUTS_IN_S
    return [fast] if abs(fast.drift_mps) > abs(hypothesis.drift_mps) else []


def _slow_for_turn(hypothesis: Hypothesis, place: Place, way: Continuation) -> None:
    """A car that turns slows down for it."""
    for _, enter, leave, turn in way.crossings:
        if leave > place.s_m and turn != 'ahead':
            hypothesis.slow_from_m = max(0.0, enter - place.s_m)
            return


def _with_right_of_way(hypothesis: Hypothesis, place: Place, way: Continuation, rules: RightOfWay) -> list[Hypothesis]:
    """The hypothesis, and where the other has to stop for the ego, that it does so."""
    track = hypothesis.track
    for junction, enter, _, turn in way.crossings:
        left_m = enter - place.s_m - track.length_m / 2
        if left_m < -1.5:
            continue
        yaw = way.path.pose(enter)[2]
        if not rules.yields_to_ego(junction, yaw, turn):
            return [hypothesis]
        needed = track.speed**2 / (2.0 * max(left_m, 0.3))
        if needed > STOPS_WITH_MPS2:
            return [hypothesis]
        stops = replace(hypothesis, stop_m=max(left_m, 0.0))
        hypothesis.weight *= 0.1 + 0.5 * (needed > SURE_MPS2)
        return [stops, hypothesis] if needed > SURE_MPS2 or left_m < 1.0 else [stops]
    return [hypothesis]


def _find_leaders(found: list[Hypothesis], places: dict[int, list[Place]]) -> None:
    """Set the leading actor of each hypothesis: the nearest one ahead on one of its lanes."""
    first: dict[int, int] = {}
    on_lane: dict[int, list[tuple[int, float]]] = {}
    for index, hypothesis in enumerate(found):
        if hypothesis.track.number in first:
            continue
        first[hypothesis.track.number] = index
        for place in places[hypothesis.track.number]:
            if abs(place.lateral_m) < 1.6:
                on_lane.setdefault(place.lane, []).append((index, place.s_m))
    for hypothesis in found:
        if hypothesis.offsets is None:
            continue
        for lane, offset in hypothesis.offsets.items():
            for index, s in on_lane.get(lane, ()):
                other = found[index]
                gap = offset + s - hypothesis.s_m - (other.track.length_m + hypothesis.track.length_m) / 2
                if other.track is hypothesis.track or offset + s <= hypothesis.s_m or gap > hypothesis.gap_m:
                    continue
                hypothesis.leader, hypothesis.gap_m = index, max(gap, 0.1)


def forecast(found: list[Hypothesis], frame: RouteFrame, times_s: Float64) -> Forecast:
    """Positions of all hypotheses at `times_s`, which are `times_s[1]` apart."""
    travelled, speed = _travel(found, times_s)
    count, steps = len(found), len(times_s)
    x, y, yaw = (np.empty((count, steps)) for _ in range(3))
    for i, h in enumerate(found):
        track = h.track
        if h.path is None:
            x[i] = track.x + travelled[i] * math.cos(track.yaw)
            y[i] = track.y + travelled[i] * math.sin(track.yaw)
            yaw[i] = track.yaw
            continue
        lateral = h.lateral_m + h.drift_mps * times_s
        if h.drift_mps > 0.0:
            lateral = np.minimum(lateral, max(h.to_lateral_m, h.lateral_m))
        elif h.drift_mps < 0.0:
            lateral = np.maximum(lateral, min(h.to_lateral_m, h.lateral_m))
        x[i], y[i], yaw[i] = poses_at(h.path, h.s_m + travelled[i], lateral)
    s, d, route_yaw = frame.project(x, y)
    turned = yaw - route_yaw
    length = np.array([h.track.length_m for h in found])
    width = np.array([h.track.width_m for h in found])
    cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    half_s = (length[:, None] * cos + width[:, None] * sin) / 2
    half_d = (length[:, None] * sin + width[:, None] * cos) / 2
    weight = np.array([h.weight for h in found])
    return Forecast(times_s, found, x, y, yaw, speed, s, d, turned, half_s, half_d, length, width, weight)


def _travel(found: list[Hypothesis], times_s: Float64) -> tuple[Float64, Float64]:
    """(N, T) distances travelled and speeds."""
    count, step_s = len(found), float(times_s[1])
    speed = np.array([h.track.speed for h in found])
    wanted = np.maximum(speed, 0.1)
    trend = np.array([0.0 if h.track.kind in ('walker', 'door') else h.track.acceleration for h in found])
    trend[np.abs(trend) < 0.3] = 0.0
    braking = trend < BRAKES_MPS2
    wanted = np.where(trend > 0.0, wanted + trend * ACCELERATES_FOR_S, wanted)
    leader = np.array([h.leader for h in found], np.int64)
    gap = np.array([h.gap_m for h in found])
    stop = np.array([h.stop_m for h in found])
    slow = np.array([h.slow_from_m for h in found])
    travelled, speeds = np.zeros((count, len(times_s))), np.empty((count, len(times_s)))
    done = np.zeros(count)
    for k, time in enumerate(times_s.tolist()):
        travelled[:, k], speeds[:, k] = done, speed
        acceleration = np.where(braking, trend, np.minimum(np.maximum(wanted - speed, -2.0), trend * (trend > 0.0)))
        if time > ACCELERATES_FOR_S:
            acceleration = np.where(braking, acceleration, np.minimum(acceleration, 0.0))
        room = gap + np.where(leader >= 0, done[leader], 0.0) - done
        closing = speed - np.where(leader >= 0, speed[leader], 0.0)
        desired = IDM_GAP_M + np.maximum(
            speed * IDM_TIME_GAP_S + speed * closing / (2.0 * math.sqrt(IDM_ACCELERATION_MPS2 * IDM_BRAKING_MPS2)), 0.0
        )
        follow = IDM_ACCELERATION_MPS2 * (1.0 - (desired / np.maximum(room, 0.3)) ** 2)
        acceleration = np.where((room < 40.0) & (closing > -0.5), np.minimum(acceleration, follow), acceleration)
        left = stop - done
        halt = -(speed**2) / (2.0 * np.maximum(left, 0.3))
        acceleration = np.where((left < 60.0) & (halt < -1.5), np.minimum(acceleration, halt), acceleration)
        turning = (slow - done < 1.5 * speed) & (speed > TURN_SPEED_MPS)
        acceleration = np.where(turning, np.minimum(acceleration, -2.0), acceleration)
        new = np.maximum(speed + np.maximum(acceleration, -8.0) * step_s, 0.0)
        done = done + 0.5 * (speed + new) * step_s
        speed = new
    return travelled, speeds
