"""What a probe records about a vehicle, and the results of the checks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration, Control, Image8, ImuSample, OdometrySample, Route

Severity = Literal['error', 'warning', 'passed', 'skipped']
Grey = NDArray[np.uint8]


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
class Trial:
    """How the car responded while `control` was sent (None: nothing was).

    times_s: since the beginning of the trial, by the vehicle's clock. speeds_mps, yaw_rates_radps: from odometry.
    started_ns: the vehicle's time at which `control` was sent first. drift_mps: distance between the odometry's
    positions at the end of the trial, per second: the speed, if the twist should be wrong.
    """

    name: str
    control: Control | None
    times_s: list[float] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    yaw_rates_radps: list[float] = field(default_factory=list)
    started_ns: int = 0
    drift_mps: float = 0.0


@dataclass(slots=True)
class Observation:
    """seconds: how long the probe listened. command_subscribers, command_publishers: of the command topic.

    images: the newest picture of each camera. pictures: stamp and (H, W) grey picture, while the car moved.
    distortion: coefficients D of each camera_info that has any. lateral_mps: `twist.linear.y` of each sample of
    `odometry`. trials: what the car did on command, in order. sim_time, wants_sim_time: whether the
    vehicle publishes /clock, and whether the user has said so.
    """

    seconds: float
    topics: dict[str, TopicSeen] = field(default_factory=dict)
    images: dict[str, Image8] = field(default_factory=dict)
    pictures: dict[str, list[tuple[int, Grey]]] = field(default_factory=dict)
    calibrations: dict[str, CameraCalibration] = field(default_factory=dict)
    distortion: dict[str, tuple[float, ...]] = field(default_factory=dict)
    imu: list[ImuSample] = field(default_factory=list)
    odometry: list[OdometrySample] = field(default_factory=list)
    lateral_mps: list[float] = field(default_factory=list)
    route: Route | None = None
    command_subscribers: int = 0
    command_publishers: int = 0
    trials: list[Trial] = field(default_factory=list)
    sim_time: bool = False
    wants_sim_time: bool = False
