"""Scripted behaviour of actors: triggers with effects, and speeds that depend on the ego."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from highway_env.vehicle.kinematics import Vehicle

# At this distance an ego triggers `ego_is_due` however slow it is.
NEARLY_THERE_M = 5.0

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import PathVehicle
    from raw2drive_ros.simulation.world import World


@dataclass(slots=True)
class Script:
    """An effect that starts when its trigger fires, once.

    Triggers (any that is set): the ego is within `ego_within_m` of the actor; the ego has reached `ego_at_s_m` of the
    route; `ego_due` = (s_m, seconds), see `ego_is_due`; simulation time `time_s`. The effect starts `delay_s` later.
    Effects: `acceleration_mps2` (down to `until_speed_mps`, for at most `lasts_s`), `target_speed_mps`, or a lateral
    drift by `drift_m` to the left over `drift_over_m` metres, or more where the speed asks for it. indicator: left or
    right, shown from the trigger on, during the delay too; a drift shows its own side until it is over.
    """

    ego_within_m: float | None = None
    ego_at_s_m: float | None = None
    ego_due: tuple[float, float] | None = None
    time_s: float | None = None
    acceleration_mps2: float | None = None
    until_speed_mps: float = 0.0
    lasts_s: float = math.inf
    target_speed_mps: float | None = None
    drift_m: float = 0.0
    drift_over_m: float = 25.0
    delay_s: float = 0.0
    indicator: str = ''
    reach_m: float = field(default=25.0, init=False)
    due_s: float | None = field(default=None, init=False)
    fired_at_s_m: float | None = field(default=None, init=False)

    def fires(self, world: World, actor: Vehicle) -> bool:
        """Whether the effect is active from this step on."""
        if self.due_s is None and self._triggered(world, actor):
            self.due_s = world.time_s + self.delay_s
        return self.due_s is not None and world.time_s >= self.due_s

    def acceleration(self, world: World, speed_mps: float) -> float | None:
        """Acceleration (m/s2) that it imposes on the actor now, or None."""
        if self.acceleration_mps2 is None or self.due_s is None or world.time_s > self.due_s + self.lasts_s:
            return None
        return self.acceleration_mps2 if speed_mps > self.until_speed_mps else 0.0

    def _triggered(self, world: World, actor: Vehicle) -> bool:
        ego = world.ego
        return bool(
            (self.ego_within_m is not None and math.hypot(*(actor.position - ego.position)) < self.ego_within_m)
            or (self.ego_at_s_m is not None and world.route_s_m >= self.ego_at_s_m)
            or (self.ego_due is not None and ego_is_due(world, *self.ego_due))
            or (self.time_s is not None and world.time_s >= self.time_s)
        )


def ego_is_due(world: World, s_m: float, seconds: float) -> bool:
    """Whether the ego's front bumper reaches `s_m` of the route within `seconds` at its speed, or is nearly there."""
    left = s_m - world.front_s_m
    return left > 0.0 and (left < world.ego.speed * seconds or left < NEARLY_THERE_M)


@dataclass(frozen=True, slots=True)
class Meeting:
    """Arrive at a conflict point together with the ego.

    own_s_m, ego_s_m: arc length of the point on the vehicle's path and on the ego's route. speeds_mps: limits of the
    vehicle's speed. The speed is controlled until the ego is `commit_m` away from the point, and constant after that.
    release_m: beyond the point by so much, the vehicle is free again; until_left_m: it is when the ego is so near.
    """

    own_s_m: float
    ego_s_m: float
    speeds_mps: tuple[float, float] = (3.0, 12.0)
    commit_m: float = 9.0
    release_m: float = math.inf
    until_left_m: float = -math.inf

    def acceleration(self, world: World, vehicle: PathVehicle) -> float | None:
        """Acceleration (m/s2), or None once it is over."""
        left, ego_left = self.own_s_m - vehicle.s_m, self.ego_s_m - world.route_s_m
        if left < -self.release_m or ego_left < self.until_left_m:
            return None
        if left <= 0.0 or ego_left < self.commit_m:
            return 0.0
        wanted = left * max(world.ego.speed, 1.0) / ego_left
        wanted = min(max(wanted, self.speeds_mps[0]), self.speeds_mps[1])
        return min(max(2.0 * (wanted - vehicle.speed), -4.0), 4.0)


@dataclass(frozen=True, slots=True)
class Pacing:
    """Match the ego's speed at `gap_m` ahead of it, until the ego has reached `until_s_m` of the route.

    gap_m: from centre to centre, as a difference of arc lengths: for paths that run along the route.
    """

    gap_m: float
    until_s_m: float
    speeds_mps: tuple[float, float] = (2.0, 14.0)

    def acceleration(self, world: World, vehicle: PathVehicle) -> float | None:
        """Acceleration (m/s2), or None once it is over."""
        if world.route_s_m >= self.until_s_m:
            return None
        wanted = world.ego.speed + 0.5 * (world.route_s_m + self.gap_m - vehicle.s_m)
        wanted = min(max(wanted, self.speeds_mps[0]), self.speeds_mps[1])
        return min(max(2.0 * (wanted - vehicle.speed), -4.0), 4.0)
