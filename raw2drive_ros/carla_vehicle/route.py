"""A route along CARLA's lanes, with a seeded random choice wherever lanes branch."""

from __future__ import annotations

from typing import Any

import numpy as np

from raw2drive_ros.carla_vehicle.geometry import pose_from_carla
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Float64


def follow_lanes(waypoint: Any, length_m: float, spacing_m: float, rng: np.random.Generator) -> Float64:
    """(N, 2) checkpoints in `map`, `spacing_m` apart, from a `carla.Waypoint` on, up to `length_m` or the road's end.

    Raises ContractError where the road ends before the second checkpoint.
    """
    points = [_position(waypoint)]
    for _ in range(round(length_m / spacing_m)):
        ways = waypoint.next(spacing_m)
        if not ways:
            break
        # The order in which the server lists them is not guaranteed.
        ways = sorted(ways, key=lambda way: (way.road_id, way.lane_id))
        waypoint = ways[int(rng.integers(len(ways)))]
        points.append(_position(waypoint))
    if len(points) < 2:
        raise ContractError(f'the road ends within {spacing_m:g} m of the start: choose another spawn point')
    return np.array(points)


def _position(waypoint: Any) -> tuple[float, float]:
    pose = pose_from_carla(waypoint.transform.get_matrix())
    return float(pose[0, 3]), float(pose[1, 3])
