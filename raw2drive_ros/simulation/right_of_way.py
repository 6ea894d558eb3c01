"""Who goes first at junctions: lights, signs, the road with right of way, straight before left turn, first come first.

A vehicle on a course asks for leave to cross while it can still stop at its line. It gets it when nobody with the right
of way comes, nobody stands or drives on its way, and there is room beyond the junction. Once it has leave it drives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.simulation.courses import LEFT, CourseBook, Crossing, LaneRef
from raw2drive_ros.simulation.layout import Junction
from raw2drive_ros.simulation.signals import RED, YELLOW

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import PathVehicle
    from raw2drive_ros.simulation.world import World

# Two centre lines are in conflict where they are closer than this.
CONFLICT_M = 2.6
# How far beyond the junction vehicles that leave by the same lane are looked at.
BEYOND_M = 5.0
# Vehicles this far from their line take part.
WITHIN_M = 70.0
# Time that has to lie between two vehicles at the same place: with right of way, and without.
GAP_PRIORITY_S, GAP_S = 1.5, 0.6
# Deceleration that a vehicle stops with at its line; with more it drives on when the light turns amber.
COMFORT_MPS2, HARDEST_STOP_MPS2 = 2.5, 3.2
# Accelerations of a start: it may arrive as early as with the first, and leave as late as with the second.
FAST_START_MPS2, SLOW_START_MPS2 = 3.0, 1.2
# Whoever has waited for so long at its line goes before all that can still stop.
IMPATIENT_S = 6.0
# An ego that stands before its line for so long does not use its right of way.
EGO_HESITATES_S = 2.0
STANDING_MPS, CREEP_MPS = 0.5, 0.05
BEYOND_LINE_M = 1.0
LINE_M = 5.0
# At a priority of its own, a vehicle slower than this lets an ego pass that is in the junction already.
SLOW_MPS = 3.0
ROOM_M = 2.5
# A car that turns right lets a cyclist pass who is so little behind it.
CYCLIST_BEHIND_M = 15.0
Zone = tuple[float, float, float, float]


@dataclass(slots=True)
class Approach:
    """A vehicle and the junction before it. vehicle: None for the ego. to_line_m: from its front, negative beyond.
    rank: 0 with right of way, 1 without. inside: it has crossed its line. closed: it has no leave. certain: it crosses
    now. claims: it has waited too long for others, who have to let it go."""

    vehicle: PathVehicle | None
    crossing: Crossing
    to_line_m: float
    s_m: float
    speed_mps: float
    half_length_m: float
    rank: int
    inside: bool
    closed: bool = False
    certain: bool = False
    claims: bool = False


def time_for(distance_m: float, speed_mps: float, top_mps: float, start_mps2: float) -> float:
    """Time (s) that a vehicle takes for a distance when it accelerates to `top_mps`; 0 for what lies behind."""
    if distance_m <= 0.0:
        return 0.0
    top = max(top_mps, speed_mps, 1.0)
    ramp = (top - speed_mps) / start_mps2
    ramp_m = (top + speed_mps) / 2.0 * ramp
    if distance_m >= ramp_m:
        return ramp + (distance_m - ramp_m) / top
    return (math.sqrt(speed_mps * speed_mps + 2.0 * start_mps2 * distance_m) - speed_mps) / start_mps2


class RightOfWay:
    """Gives vehicles leave to cross. Its state is in the vehicles, so forks of the world share it."""

    def __init__(self, book: CourseBook) -> None:
        self.book = book
        self.zones: dict[tuple[LaneRef, LaneRef], Zone | None] = {}

    def decide(self, world: World, vehicles: Sequence[PathVehicle]) -> None:
        """Set `stop_at_m` of every vehicle with a course: arc length of the line where it has to stop, or inf."""
        junctions: dict[int, list[Approach]] = {}
        for vehicle in vehicles:
            if vehicle.course is not None:
                self._approach(world, vehicle, junctions)
        for number in sorted(junctions):
            approaches = junctions[number]
            ego = ego_approach(world, number)
            if ego is not None:
                approaches.append(ego)
            for approach in approaches:
                approach.certain = approach.certain or self._is_committed(world, approach)
            approaches.sort(key=lambda a: self._order(a))
            for approach in approaches:
                if approach.vehicle is not None and not approach.inside:
                    self._give_leave(world, approach, approaches)

    @staticmethod
    def _order(approach: Approach) -> tuple[bool, bool, int, float, int]:
        """Who is asked first: those inside, those who have waited too long, then by right of way."""
        vehicle = approach.vehicle
        if vehicle is None:
            return not approach.inside, True, approach.rank, 0.0, -1
        impatient = vehicle.waited_s > IMPATIENT_S
        return not approach.inside, not impatient, approach.rank, -vehicle.waited_s, vehicle.number

    @staticmethod
    def _is_committed(world: World, approach: Approach) -> bool:
        """Whether a vehicle crosses whatever the others do."""
        vehicle = approach.vehicle
        if vehicle is None or vehicle.course is None or approach.inside:
            return False
        if not vehicle.yields and not _stays(approach):
            return not vehicle.obeys_lights or light_of(world, approach.crossing) != RED
        current = approach.crossing is vehicle.course.crossings[vehicle.next_crossing]
        return vehicle.has_leave and current and not _can_stop(approach)

    def _approach(self, world: World, vehicle: PathVehicle, junctions: dict[int, list[Approach]]) -> None:
        crossings = vehicle.course.crossings if vehicle.course else ()
        half = vehicle.LENGTH / 2
        vehicle.stop_at_m = math.inf
        while vehicle.next_crossing < len(crossings):
            crossing = crossings[vehicle.next_crossing]
            if vehicle.s_m - half < crossing.leave_s_m + BEYOND_M:
                break
            vehicle.next_crossing += 1
            vehicle.has_leave = False
        # A vehicle that has not quite left a junction may be near the next one already.
        for crossing in crossings[vehicle.next_crossing : vehicle.next_crossing + 2]:
            to_line = crossing.stop_s_m - vehicle.s_m - half
            if to_line > WITHIN_M:
                break
            current = crossing is crossings[vehicle.next_crossing]
            # Who has stopped with its bumper just beyond the line has not entered.
            entered = to_line < (0.0 if vehicle.has_leave and current else -BEYOND_LINE_M)
            approach = Approach(
                vehicle,
                crossing,
                to_line,
                vehicle.s_m,
                vehicle.speed,
                half,
                rank_of(world, crossing),
                entered,
            )
            if entered and current:
                vehicle.has_leave = True
            if current or to_line < WITHIN_M / 2:
                junctions.setdefault(crossing.junction, []).append(approach)

    def _give_leave(self, world: World, approach: Approach, approaches: Sequence[Approach]) -> None:
        vehicle, crossing = approach.vehicle, approach.crossing
        assert vehicle is not None and vehicle.course is not None
        current = crossing is vehicle.course.crossings[vehicle.next_crossing]
        speed, left = vehicle.speed, approach.to_line_m
        standing = speed < STANDING_MPS and left < LINE_M
        vehicle.waited_s = vehicle.waited_s + world.decision_s if standing else 0.0 if speed > 1.0 else vehicle.waited_s
        can_stop = _can_stop(approach)
        if vehicle.has_leave and current and not can_stop:
            return
        colour = light_of(world, crossing) if vehicle.obeys_lights else ''
        if colour == RED or (colour == YELLOW and can_stop):
            closed = True
        elif not vehicle.yields:
            closed = False
        elif left > max(10.0, speed * speed / (2.0 * 1.8) + 0.5 * speed + 3.0):
            # Too early to tell. Others count with it when it has the right of way.
            return
        else:
            room = self._has_room(vehicle, approach)
            closed = not room or any(
                self._in_the_way(world, approach, other) for other in approaches if other is not approach
            )
            approach.claims = room and closed and vehicle.waited_s > IMPATIENT_S
        approach.closed = closed
        if current:
            vehicle.has_leave = not closed
        if closed:
            vehicle.stop_at_m = min(vehicle.stop_at_m, crossing.stop_s_m)
        else:
            approach.certain = True

    @staticmethod
    def _has_room(vehicle: PathVehicle, approach: Approach) -> bool:
        """Whether it would not have to stop in the junction behind somebody who stands."""
        gap = vehicle.others_gap_m
        leader_mps = vehicle.speed - vehicle.others_closing_mps
        if gap < approach.to_line_m or leader_mps > 1.5:
            return True
        needed = approach.crossing.leave_s_m - approach.crossing.stop_s_m + 2.0 * approach.half_length_m + ROOM_M
        return gap - approach.to_line_m > needed

    def _in_the_way(self, world: World, one: Approach, other: Approach) -> bool:
        """Whether `other` keeps `one` from crossing."""
        vehicle = one.vehicle
        assert vehicle is not None
        zone = self.zone(one.crossing.connector, other.crossing.connector)
        if zone is None:
            return _turns_across_a_cyclist(one, other)
        if _stays(other):
            return False
        yields = must_yield(one, other)
        own_in, own_out = self._times(one, zone[0], zone[1], vehicle.target_speed)
        if other.inside:
            if other.vehicle is None and not yields and one.speed_mps > SLOW_MPS:
                return False
            _, out = self._times(other, zone[2], zone[3], other.speed_mps if other.vehicle is None else 6.0)
            stuck = other.speed_mps < STANDING_MPS and out > 0.0
            return out > 0.0 and (stuck or out + GAP_S > own_in)
        if other.claims and other.vehicle is not None and other.vehicle.waited_s > vehicle.waited_s:
            return True
        if other.closed:
            return False
        margin = GAP_PRIORITY_S if yields else GAP_S
        if other.vehicle is None:
            if not yields or world.ego_stood_s > EGO_HESITATES_S:
                return False
            top = max(other.speed_mps, 2.0)
        else:
            if not other.certain and not (yields and not _waits_for(vehicle, other)):
                return False
            top = other.vehicle.target_speed
        into, out = self._times(other, zone[2], zone[3], top)
        return own_in < out + margin and into < own_out + margin

    @staticmethod
    def _times(approach: Approach, begin_m: float, end_m: float, top_mps: float) -> tuple[float, float]:
        """(from, until) when a vehicle is in a part of its lane across the junction."""
        offset = approach.crossing.enter_s_m - approach.s_m
        half = approach.half_length_m
        speed = approach.speed_mps
        return (
            time_for(offset + begin_m - half, speed, top_mps, FAST_START_MPS2),
            time_for(offset + end_m + half, speed, min(top_mps, 8.0), SLOW_START_MPS2),
        )

    def zone(self, one: LaneRef, other: LaneRef) -> Zone | None:
        """(begin, end) along lane `one` and (begin, end) along `other`, from where they enter the junction, in which
        vehicles on both would touch; None without such a place, or for vehicles that come from the same lane."""
        key = (one, other)
        if key not in self.zones:
            self.zones[key] = None if one[0] == other[0] and one[2] == other[2] else self._zone(one, other)
        return self.zones[key]

    def _zone(self, one: LaneRef, other: LaneRef) -> Zone | None:
        points, along = self.book.points_of(one, BEYOND_M)
        others, beside = self.book.points_of(other, BEYOND_M)
        gaps = points[:, None] - others[None]
        close = np.einsum('abk,abk->ab', gaps, gaps) < CONFLICT_M**2
        rows, columns = np.flatnonzero(close.any(axis=1)), np.flatnonzero(close.any(axis=0))
        if not len(rows):
            return None
        return float(along[rows[0]]), float(along[rows[-1]]), float(beside[columns[0]]), float(beside[columns[-1]])


def _turns_across_a_cyclist(one: Approach, other: Approach) -> bool:
    """Whether a car that turns right would cut off a cyclist beside it, who goes on."""
    vehicle, rider = one.vehicle, other.vehicle
    if vehicle is None or rider is None or rider.kind != 'cyclist' or vehicle.kind == 'cyclist':
        return False
    if one.crossing.source_arm != other.crossing.source_arm or one.crossing.turn != 'right':
        return False
    if other.crossing.turn == 'right':
        return False
    # Beyond the car's turn it is in nobody's way any more.
    beyond_m = one.crossing.stop_s_m - one.crossing.leave_s_m
    return beyond_m < other.to_line_m < one.to_line_m + CYCLIST_BEHIND_M


def _stays(approach: Approach) -> bool:
    """Whether a vehicle stands before its line until a script starts it."""
    vehicle = approach.vehicle
    return vehicle is not None and not approach.inside and vehicle.target_speed < CREEP_MPS > vehicle.speed


def _can_stop(approach: Approach) -> bool:
    """Whether a vehicle can stop at its line without braking hard."""
    return approach.speed_mps**2 < 2.0 * HARDEST_STOP_MPS2 * max(approach.to_line_m, 0.01)


def _waits_for(vehicle: PathVehicle, other: Approach) -> bool:
    """Whether `other`, with the right of way, has to let `vehicle` go because that one has waited too long."""
    assert other.vehicle is not None
    if vehicle.waited_s < IMPATIENT_S or not other.vehicle.yields or other.vehicle.waited_s > vehicle.waited_s:
        return False
    return other.speed_mps**2 < 2.0 * COMFORT_MPS2 * max(other.to_line_m - 1.0, 0.01)


def must_yield(one: Approach, other: Approach) -> bool:
    """Whether `one` has to let `other` go first by the rules of the road."""
    if other.vehicle is not None and one.vehicle is not None and other.vehicle.yields != one.vehicle.yields:
        return one.vehicle.yields
    if one.rank != other.rank:
        return one.rank > other.rank
    if opposite(one.crossing.source_arm, other.crossing.source_arm):
        return one.crossing.turn == LEFT and other.crossing.turn != LEFT
    return False


def opposite(arm: str, other: str) -> bool:
    """Whether two arms of a junction lie across from each other."""
    return {arm, other} in ({'back', 'ahead'}, {'left', 'right'})


def rank_of(world: World, crossing: Crossing) -> int:
    """0 for the road with right of way, and where all are equal; 1 for the other road."""
    site = world.road.junctions[crossing.junction]
    if crossing.junction in world.light_of:
        return 0
    main = main_arms(site.spec)
    return 0 if not main or crossing.source_arm in main else 1


def main_arms(junction: Junction) -> tuple[str, ...]:
    """Arms of the road with right of way; () where all are equal."""
    return junction.main_arms()


def light_of(world: World, crossing: Crossing) -> str:
    """The colour that a vehicle sees, or ''."""
    light = world.light_of.get(crossing.junction)
    return '' if light is None else light.colour_for(crossing.source_arm)


def ego_approach(world: World, junction: int) -> Approach | None:
    """The ego as one of the vehicles at a junction of its route, or None."""
    crossing = world.ego_crossings.get(junction)
    if crossing is None:
        return None
    half = world.ego.LENGTH / 2
    to_line = crossing.stop_s_m - world.front_s_m
    if to_line > WITHIN_M or world.route_s_m - half > crossing.leave_s_m + BEYOND_M:
        return None
    light = light_of(world, crossing)
    closed = light == RED or (light == YELLOW and to_line > 0.0)
    inside = to_line < -BEYOND_LINE_M
    speed = max(world.ego.speed, 0.0)
    return Approach(
        None, crossing, to_line, world.route_s_m, speed, half, rank_of(world, crossing), inside, closed and not inside
    )
