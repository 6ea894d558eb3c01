"""How samples of sensors that do not share a trigger become one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.public import ImuSample, OdometrySample
from raw2drive_ros.tables.rates import DECISION_NS

# A picture is used once a decision period less this has passed since the last one that was: every picture of a camera
# of 10 Hz, jitter included, every second one of 20 Hz, every third one of 30 Hz.
EARLY_NS = 15_000_000
# More would be ambiguous: free-running cameras of 10 Hz differ by half a period at most.
LARGEST_SKEW_S = 0.05
LARGEST_AGE_S = 0.2


def is_due(stamp_ns: int, taken_ns: int | None) -> bool:
    """Whether a picture is decided upon after the one of `taken_ns`: one decision per period, by the stamps. What is
    not later than that is not decided here: it is a repetition, or late."""
    return taken_ns is None or not 0 < stamp_ns - taken_ns < DECISION_NS - EARLY_NS


@dataclass(frozen=True, slots=True)
class Synchronisation:
    """interpolate_age_s: IMU and odometry are interpolated to the pictures' stamp between two samples that are no
    further from it than this; 0: only samples of exactly that stamp are used. camera_skew_s: pictures whose stamps
    differ by no more than this are one frame; 0: only those of one stamp are. Raises ConfigError."""

    interpolate_age_s: float = 0.0
    camera_skew_s: float = 0.0

    def __post_init__(self) -> None:
        for name, largest in (('interpolate_age_s', LARGEST_AGE_S), ('camera_skew_s', LARGEST_SKEW_S)):
            value = getattr(self, name)
            if not 0.0 <= value <= largest:
                raise ConfigError(f'{name} is {value:g}; use 0 to {largest:g} seconds')


Sample = TypeVar('Sample', ImuSample, OdometrySample)


def sample_at(samples: dict[int, Sample], stamp_ns: int, age_ns: int) -> Sample | None:
    """The sample of a stamp: the one that carries it, or one between the last before and the first after it. None
    while there is none after it, and where one of the two is further from the stamp than `age_ns`."""
    if stamp_ns in samples or not age_ns:
        return samples.get(stamp_ns)
    before_ns = max((stamp for stamp in samples if stamp < stamp_ns), default=None)
    after_ns = min((stamp for stamp in samples if stamp > stamp_ns), default=None)
    if before_ns is None or after_ns is None or max(stamp_ns - before_ns, after_ns - stamp_ns) > age_ns:
        return None
    share = (stamp_ns - before_ns) / (after_ns - before_ns)
    return between(samples[before_ns], samples[after_ns], share, stamp_ns)


def between(before: Sample, after: Sample, share: float, stamp_ns: int) -> Sample:
    """The sample `share` of the way from one to the other; a yaw goes the shorter way round, within +-pi."""

    def mix(one: float, other: float) -> float:
        return one + share * (other - one)

    if isinstance(before, ImuSample):
        assert isinstance(after, ImuSample)
        fields = ('specific_force_mps2', 'angular_velocity_radps')
        pairs = [zip(getattr(before, name), getattr(after, name), strict=True) for name in fields]
        force, rate = (tuple(mix(one, other) for one, other in pair) for pair in pairs)
        return ImuSample(stamp_ns, force, rate)  # type: ignore[arg-type]
    assert isinstance(after, OdometrySample)
    turn_rad = math.remainder(after.yaw_rad - before.yaw_rad, math.tau)
    return OdometrySample(
        stamp_ns,
        mix(before.x_m, after.x_m),
        mix(before.y_m, after.y_m),
        math.remainder(before.yaw_rad + share * turn_rad, math.tau),
        mix(before.speed_mps, after.speed_mps),
        mix(before.yaw_rate_radps, after.yaw_rate_radps),
    )
