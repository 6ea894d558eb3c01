"""Reactive baselines that read the simulator's state: constant speed, and highway-env's IDM with MOBIL."""

from __future__ import annotations

import math

from highway_env.vehicle.behavior import IDMVehicle

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import leader, pedals, pursuit_steer, route_window
from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

CONSTANT_SPEED_MPS = 6.0
MERGE_RATE_MPS = 1.2
BEHIND_M = 40.0


def constant_speed(world: World) -> Control:
    """Drive at `CONSTANT_SPEED_MPS` along the route, whatever is ahead."""
    speed = max(world.ego.speed, 0.0)
    return pedals(world, 1.5 * (CONSTANT_SPEED_MPS - speed), pursuit_steer(world))


class IdmMobilDriver:
    """IDM with highway-env's parameters behind the leading actor, and highway-env's MOBIL for lane changes.

    It changes to another lane of the ego's direction for an advantage, and back to the route's lane where that has no
    disadvantage. It ignores lights and signs.
    """

    def __init__(self) -> None:
        self.offset_m = self.target_m = 0.0
        self.decided_s = -math.inf

    def control(self, world: World) -> Control:
        if world.time_s - self.decided_s >= IDMVehicle.LANE_CHANGE_DELAY:
            self.decided_s = world.time_s
            self.target_m = self._choose(world)
        step = MERGE_RATE_MPS / DECISION_HZ
        self.offset_m += min(max(self.target_m - self.offset_m, -step), step)
        acceleration = min(idm(world, self.offset_m), idm(world, self.target_m))
        return pedals(world, acceleration, pursuit_steer(world, offset_m=self.offset_m))

    def _choose(self, world: World) -> float:
        """Offset (m) of the target lane by MOBIL's incentive and safety criteria (politeness 0, as in highway-env)."""
        here = idm(world, self.target_m)
        best, best_gain = self.target_m, IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN
        width = world.scene.layout.lane_width_m
        for target in (self.target_m - width, self.target_m + width):
            if not _is_lane(world, target) or not _follower_can_brake(world, target):
                continue
            # A bonus for lanes closer to the route's own.
            bonus = 2.0 * IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN * (abs(target) < abs(self.target_m))
            gain = idm(world, target) - here + bonus
            if gain > best_gain:
                best, best_gain = target, gain
        return best


def idm(world: World, offset_m: float) -> float:
    """Acceleration (m/s2) of highway-env's IDM in the lane `offset_m` left of the route."""
    speed = max(world.ego.speed, 0.0)
    wanted = world.speed_limit_at(world.route_s_m)
    acceleration = IDMVehicle.COMFORT_ACC_MAX * (1.0 - (speed / max(wanted, 0.1)) ** IDMVehicle.DELTA)
    gap, closing = leader(world, route_window(world, offset_m))
    if gap < math.inf:
        comfort = 2.0 * math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
        # highway-env measures distances between centres; the gap here is between bumpers.
        desired = IDMVehicle.DISTANCE_WANTED - world.ego.LENGTH
        desired += speed * IDMVehicle.TIME_WANTED + speed * closing / comfort
        acceleration -= IDMVehicle.COMFORT_ACC_MAX * (max(desired, 0.0) / max(gap, 0.1)) ** 2
    return max(acceleration, -IDMVehicle.ACC_MAX)


def _is_lane(world: World, offset_m: float) -> bool:
    """Whether there is a lane in the ego's direction `offset_m` left of the route."""
    layout = world.scene.layout
    if layout.forward_lanes < 2 or world.scene.route.from_ramp:
        return False
    x, y, _ = world.route.pose(world.route_s_m, offset_m)
    lateral = world.road.forward_path_cached().project(x, y)[1]
    return -(layout.forward_lanes - 0.5) * layout.lane_width_m < lateral < 0.5 * layout.lane_width_m


def _follower_can_brake(world: World, offset_m: float) -> bool:
    """MOBIL's safety criterion: nobody is beside the ego in that lane, and the follower there need not brake hard."""
    nearest = -math.inf
    follower = None
    for actor in world.actors:
        s, lateral = world.route.project(*map(float, actor.position), world.route_s_m, BEHIND_M)
        ahead = s - world.route_s_m
        if abs(lateral - offset_m) > world.scene.layout.lane_width_m / 2 or not -BEHIND_M < ahead < world.ego.LENGTH:
            continue
        if ahead > -world.ego.LENGTH:
            return False
        if ahead > nearest and isinstance(actor, PathVehicle):
            nearest, follower = ahead, actor
    if follower is None:
        return True
    closing = follower.speed - world.ego.speed
    comfort = 2.0 * math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
    desired = IDMVehicle.DISTANCE_WANTED - world.ego.LENGTH
    desired += follower.speed * IDMVehicle.TIME_WANTED + follower.speed * closing / comfort
    gap = -nearest - world.ego.LENGTH
    return (
        -IDMVehicle.COMFORT_ACC_MAX * (max(desired, 0.0) / max(gap, 0.1)) ** 2
        > -IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
    )
