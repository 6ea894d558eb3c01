"""Privileged baselines without foresight: constant speed, and highway-env's IDM, both steering along the route.

highway-env's MOBIL is left out: the route says which lane to be in.
"""

from __future__ import annotations

import math

from highway_env.vehicle.behavior import IDMVehicle

from raw2drive_ros.contract import Control
from raw2drive_ros.evaluation.expert import LOOK_AHEAD_S, leader
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.world import World

CONSTANT_SPEED_MPS = 6.0


def constant_speed(world: World) -> Control:
    """Drives on at `CONSTANT_SPEED_MPS`, whatever is ahead."""
    speed = max(world.ego.speed, 0.0)
    return pedals(world, 1.5 * (CONSTANT_SPEED_MPS - speed), pursuit_steer(world, LOOK_AHEAD_S))


def idm(world: World) -> Control:
    """highway-env's IDM with its own parameters, behind whatever is in the ego's corridor; no lights, no signs."""
    speed = max(world.ego.speed, 0.0)
    wanted = world.speed_limit_at(world.route_s_m)
    acceleration = IDMVehicle.COMFORT_ACC_MAX * (1.0 - (speed / max(wanted, 0.1)) ** IDMVehicle.DELTA)
    gap, closing = leader(world)
    if gap < math.inf:
        comfort = 2.0 * math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
        # highway-env measures distances between centres; the gap here is between bumpers.
        desired = IDMVehicle.DISTANCE_WANTED - world.ego.LENGTH
        desired += speed * IDMVehicle.TIME_WANTED + speed * closing / comfort
        acceleration -= IDMVehicle.COMFORT_ACC_MAX * (max(desired, 0.0) / max(gap, 0.1)) ** 2
    return pedals(world, max(acceleration, -IDMVehicle.ACC_MAX), pursuit_steer(world, LOOK_AHEAD_S))
