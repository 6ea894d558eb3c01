"""Comfort of synthetic motion: each limit alone, and `bench2drive_compat` reproduces Bench2Drive's mistakes."""

import numpy as np
import pytest

from raw2drive_ros.evaluation.comfort import SEGMENT, comfort_percent, savitzky_golay


def motion(longitudinal=0.0, lateral=0.0, yaw_rate=0.0, segments: float = 1.0) -> np.ndarray:
    """(N, 3) at 20 Hz: constants, or functions of time in seconds. segments: of 2 s."""
    seconds = np.arange(round(2 * SEGMENT * segments)) / 20.0
    return np.stack(
        [f(seconds) if callable(f) else np.full(len(seconds), f) for f in (longitudinal, lateral, yaw_rate)], 1
    )


def test_a_parabola_is_smoothed_to_itself_and_differentiated_exactly() -> None:
    t = np.arange(SEGMENT, dtype=float)
    parabola = 3.0 + 2.0 * t - 0.5 * t**2
    assert savitzky_golay(0) @ parabola == pytest.approx(parabola)
    assert savitzky_golay(1) @ parabola == pytest.approx(2.0 - t)


@pytest.mark.parametrize(
    ('kind', 'comfortable'),
    [
        ({'longitudinal': 2.3}, True),
        ({'longitudinal': 2.5}, False),
        ({'longitudinal': -4.0}, True),
        ({'longitudinal': -4.1}, False),
        ({'lateral': -4.8}, True),
        ({'lateral': 4.95}, False),
        ({'yaw_rate': 0.9}, True),
        ({'yaw_rate': -1.0}, False),
        ({'longitudinal': lambda t: np.clip(4.0 * (t - 1.0), -3.9, 2.3)}, True),
        ({'longitudinal': lambda t: np.clip(4.2 * (t - 1.0), -3.9, 2.3)}, False),
        ({'lateral': lambda t: np.clip(5.0 * (t - 1.0), 0.0, 4.8)}, True),
        ({'lateral': lambda t: np.clip(9.0 * (t - 1.0), 0.0, 4.8)}, False),
        ({'yaw_rate': lambda t: np.clip(1.9 * (t - 1.0), -0.9, 0.9)}, True),
        ({'yaw_rate': lambda t: np.clip(2.0 * (t - 1.0), -0.9, 0.9)}, False),
    ],
)  # fmt: skip
def test_each_limit_alone(kind, comfortable) -> None:
    assert comfort_percent(motion(**kind)) == (100.0 if comfortable else 0.0)


def test_share_of_segments_and_the_incomplete_tail_is_dropped() -> None:
    good, bad = motion(segments=3), motion(longitudinal=3.0)
    assert comfort_percent(np.concatenate([good, bad])) == 75.0
    assert comfort_percent(np.concatenate([good, bad[:-1]])) == 100.0


def test_a_single_jolt_spoils_the_two_seconds_around_it() -> None:
    jolt = motion(segments=4)
    jolt[50:52, 0] = -40.0
    assert comfort_percent(jolt) == 75.0


def test_shorter_than_a_segment_is_undefined() -> None:
    assert comfort_percent(motion()[:-1]) is None
    assert comfort_percent(np.zeros((0, 3))) is None


def test_bench2drive_compat_halves_jerk_and_take_degrees_for_radians() -> None:
    jerk = motion(longitudinal=lambda t: np.where(t < 1.0, 6.0 * (t - 0.6), 2.3))
    assert comfort_percent(jerk) == 0.0
    assert comfort_percent(jerk, bench2drive_compat=True) == 100.0
    turning = motion(yaw_rate=0.02)
    assert comfort_percent(turning) == 100.0
    assert comfort_percent(turning, bench2drive_compat=True) == 0.0, '1.15 deg/s is above 0.95'
