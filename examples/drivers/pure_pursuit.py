"""A driver as a class: follows the route at a steady speed and looks at nothing.

raw2drive evaluate --driver examples.drivers.pure_pursuit:PurePursuit --driver-args speed_mps=6 --routes lane-following
"""

import itertools
import math

import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.driver_class import Sensors

WHEELBASE_M, MAX_STEER_RAD = 2.9, 0.6


class PurePursuit:
    """speed_mps: that it keeps."""

    sensors = ('odometry', 'route')

    def __init__(self, speed_mps: float = 5.0) -> None:
        self.speed_mps = speed_mps

    def drive(self, sensors: Sensors) -> Control:
        """Aim at a point of the line through the checkpoints, 4 m ahead and more when it is fast."""
        here, points = sensors.odometry, sensors.route.checkpoints_m
        steps = [np.linspace(a, b, 50, endpoint=False) for a, b in itertools.pairwise(points)]
        line = np.concatenate([*steps, points[-1:]]) - (here.x_m, here.y_m)
        distance = np.hypot(line[:, 0], line[:, 1])
        ahead = np.flatnonzero(distance[distance.argmin() :] > 4.0 + 0.5 * here.speed_mps)
        x, y = line[distance.argmin() + ahead[0]] if len(ahead) else line[-1]
        angle = math.atan2(y, x) - here.yaw_rad
        steer = math.atan(2.0 * WHEELBASE_M * math.sin(angle) / math.hypot(x, y)) / MAX_STEER_RAD
        pedal = 0.4 * (self.speed_mps - here.speed_mps)
        return Control(min(max(pedal, 0.0), 1.0), min(max(-pedal, 0.0), 1.0), min(max(steer, -1.0), 1.0))
