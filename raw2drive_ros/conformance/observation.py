"""What a probe records about a vehicle, and the results of the checks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from raw2drive_ros.contracts.public import CameraCalibration, Control, Image8, ImuSample, OdometrySample, Route

Severity = Literal['error', 'warning', 'passed', 'skipped']


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of one check. text: what was observed. remedy: what to do, empty when it passed."""

    check: str
    severity: Severity
    text: str
    remedy: str = ''


@dataclass(slots=True)
class TopicSeen:
    """One topic. stamps_ns: of the messages' headers, in order of arrival. ages_s: ROS time of arrival minus stamp.
    refused: why messages violated their contract."""

    msgtypes: tuple[str, ...] = ()
    publishers: int = 0
    reliable: bool = True
    transient_local: bool = False
    stamps_ns: list[int] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)
    refused: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Observation:
    """seconds: how long the probe listened. command_subscribers, command_publishers: of the command topic."""

    seconds: float
    topics: dict[str, TopicSeen] = field(default_factory=dict)
    images: dict[str, Image8] = field(default_factory=dict)
    calibrations: dict[str, CameraCalibration] = field(default_factory=dict)
    imu: list[ImuSample] = field(default_factory=list)
    odometry: list[OdometrySample] = field(default_factory=list)
    route: Route | None = None
    command_subscribers: int = 0
    command_publishers: int = 0


@dataclass(slots=True)
class Trial:
    """How the car responded while `control` was sent (None: nothing was).

    times_s: since the beginning of the trial. speeds_mps, yaw_rates_radps: from odometry.
    """

    name: str
    control: Control | None
    times_s: list[float] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    yaw_rates_radps: list[float] = field(default_factory=list)
