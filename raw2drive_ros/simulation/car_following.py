"""How traffic follows: IDM with a bound from what a situation needs, and how long a lateral drift takes."""

from __future__ import annotations

import math

from highway_env.vehicle.behavior import IDMVehicle

from raw2drive_ros.simulation.leaders import LOOK_AHEAD_M

# Deceleration of a calm driver, the hardest braking, and the strongest lateral acceleration of a scripted drift.
COMFORT_MPS2 = 2.5
MAX_BRAKING_MPS2 = 8.0
DRIFT_MPS2 = 3.8
# A vehicle falls back with this deceleration where another one pushes into its way from beside it.
BESIDE_M, BESIDE_MPS2 = 1.5, 5.0


def needed_mps2(gap_m: float, closing_mps: float) -> float:
    """The deceleration (m/s2) that is needed to lose `closing_mps` within `gap_m`, but for half a metre."""
    return closing_mps * closing_mps / (2.0 * max(gap_m - 0.5, 0.2))


def follow(speed: float, free_mps2: float, gap_m: float, closing_mps: float, time_gap_s: float) -> float:
    """Acceleration (m/s2) behind a leading vehicle: IDM, but not harder than the situation asks for.

    free_mps2: what it would be without one. A gap that is too short, but does not shrink, is opened gently.
    """
    if gap_m >= LOOK_AHEAD_M:
        return max(free_mps2, IDMVehicle.COMFORT_ACC_MIN)
    comfort = math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
    wanted_gap = 3.0 + max(0.0, speed * time_gap_s + speed * closing_mps / (2.0 * comfort))
    wanted = free_mps2 - IDMVehicle.COMFORT_ACC_MAX * (wanted_gap / max(gap_m, 0.1)) ** 2
    hardest = COMFORT_MPS2 if gap_m > BESIDE_M else BESIDE_MPS2
    if closing_mps > 0.0:
        hardest = max(hardest, 1.4 * needed_mps2(gap_m - 1.0, closing_mps) + 0.5)
    return max(wanted, -min(hardest, MAX_BRAKING_MPS2))


def drift_length_m(drift_m: float, speed_mps: float) -> float:
    """The shortest way (m) for a lateral drift with at most `DRIFT_MPS2` sideways: 6 d / T^2 for a cubic step."""
    return speed_mps * math.sqrt(6.0 * abs(drift_m) / DRIFT_MPS2)
