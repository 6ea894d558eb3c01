"""The ego vehicle: a kinematic bicycle with first-order actuators for throttle, brake and steering, and a reverse gear.

`base_link` is the vehicle's centre on the ground. highway-env's own vehicle takes a single acceleration and starts to
reverse when it brakes for too long; this one stops at zero speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from highway_env.vehicle.kinematics import Vehicle

from raw2drive_ros.contracts.public import Control, ImuSample, OdometrySample

GRAVITY_MPS2 = 9.81
IMU_X_M = -1.4


@dataclass(frozen=True, slots=True)
class EgoParameters:
    """Parameters of a mid-size electric car; steering angles are those of the front wheels."""

    wheelbase_m: float = 2.9
    max_steer_rad: float = 0.6
    drive_acceleration_mps2: float = 5.0
    drive_power_mps3: float = 40.0
    brake_deceleration_mps2: float = 8.0
    reverse_top_speed_mps: float = 5.0
    drag_constant_mps2: float = 0.3
    drag_linear_1ps: float = 0.06
    drag_quadratic_1pm: float = 0.002
    steer_time_constant_s: float = 0.15
    pedal_time_constant_s: float = 0.10


class EgoVehicle(Vehicle):
    """Stepped by the environment with a `Control`; highway-env's `action` is not used."""

    LENGTH = 4.8
    WIDTH = 2.0
    HEIGHT = 1.5

    def __init__(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, parameters: EgoParameters) -> None:
        super().__init__(None, (x_m, y_m), yaw_rad, speed_mps)
        self.parameters = parameters
        self.command = Control()
        self.throttle = 0.0
        self.brake = 0.0
        self.steer = 0.0
        self.yaw_rate = 0.0
        self.steer_push = 0.0
        self.grip = 1.0
        self.acceleration_body = (0.0, 0.0)

    def act(self, action: dict[str, float] | str | None = None) -> None:
        """Does nothing: commands arrive through `command`."""

    def step(self, dt: float) -> None:
        p, command = self.parameters, self.command
        pedal = 1.0 - math.exp(-dt / p.pedal_time_constant_s)
        self.throttle += pedal * (command.throttle - self.throttle)
        self.brake += pedal * (command.brake - self.brake)
        self.steer += (1.0 - math.exp(-dt / p.steer_time_constant_s)) * (
            min(max(command.steer + self.steer_push, -1.0), 1.0) - self.steer
        )

        old_speed, old_yaw = self.speed, self.heading
        old_beta = math.atan(0.5 * math.tan(self.steer * p.max_steer_rad))
        velocity = (old_speed * math.cos(old_yaw + old_beta), old_speed * math.sin(old_yaw + old_beta))
        self.speed = self._next_speed(dt)
        beta = old_beta
        mean_speed = 0.5 * (old_speed + self.speed)
        self.yaw_rate = self.speed * math.sin(beta) / (p.wheelbase_m / 2)
        mid_yaw = old_yaw + 0.5 * self.yaw_rate * dt
        self.position[0] += mean_speed * math.cos(mid_yaw + beta) * dt
        self.position[1] += mean_speed * math.sin(mid_yaw + beta) * dt
        self.heading = math.remainder(old_yaw + self.yaw_rate * dt, 2 * math.pi)
        yaw = self.heading
        change_x = (self.speed * math.cos(yaw + beta) - velocity[0]) / dt
        change_y = (self.speed * math.sin(yaw + beta) - velocity[1]) / dt
        self.acceleration_body = (
            change_x * math.cos(mid_yaw) + change_y * math.sin(mid_yaw),
            -change_x * math.sin(mid_yaw) + change_y * math.cos(mid_yaw),
        )

    def _next_speed(self, dt: float) -> float:
        """Speed after `dt`: drive force up to the power limit, then brake and drag, which cannot reverse the motion."""
        p, v = self.parameters, self.speed
        drive = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(abs(v), 1e-6)) * self.throttle * self.grip
        if self.command.reverse:
            drive = -drive if v > -p.reverse_top_speed_mps else 0.0
        resist = self.brake * p.brake_deceleration_mps2 * self.grip
        if abs(v) > 1e-9 or drive != 0.0:
            resist += p.drag_constant_mps2 + p.drag_linear_1ps * abs(v) + p.drag_quadratic_1pm * v * v
        pushed = v + drive * dt
        if pushed > 0:
            return max(0.0, pushed - resist * dt)
        return min(0.0, pushed + resist * dt)

    @property
    def beta_rad(self) -> float:
        """Sideslip angle at the vehicle's centre."""
        return math.atan(0.5 * math.tan(self.steer * self.parameters.max_steer_rad))

    def imu(self, stamp_ns: int, noise: tuple[float, ...] = (0.0,) * 6) -> ImuSample:
        """Specific force and angular rate at the IMU, at `IMU_X_M` in `base_link`, lever arm included (REP-145)."""
        ax, ay = self.acceleration_body
        rate = self.yaw_rate
        return ImuSample(
            stamp_ns,
            (ax - rate * rate * IMU_X_M + noise[0], ay + noise[1], GRAVITY_MPS2 + noise[2]),
            (noise[3], noise[4], rate + noise[5]),
        )

    def odometry(self, stamp_ns: int) -> OdometrySample:
        return OdometrySample(
            stamp_ns,
            float(self.position[0]),
            float(self.position[1]),
            float(self.heading),
            self.speed * math.cos(self.beta_rad),
            self.yaw_rate,
        )
