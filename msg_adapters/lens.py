"""Lens distortion as sensor_msgs/CameraInfo describes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Float64

# distortion_model of sensor_msgs (distortion_models.hpp) -> numbers of coefficients that OpenCV takes for it.
MODELS = {'plumb_bob': (4, 5), 'rational_polynomial': (8, 12, 14), 'equidistant': (4,)}


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera that does not take a pinhole's pictures.

    model: a key of `MODELS`. coefficients: D. width, height: of its pictures, pixels. intrinsics: (3, 3) K of the
    pictures as they are taken.
    """

    camera: str
    model: str
    width: int
    height: int
    intrinsics: Float64
    coefficients: Float64


def lens_from_message(camera: str, info: Any) -> Lens | None:
    """The lens of a CameraInfo; None where there is no distortion. Raises ContractError for one that is not known."""
    coefficients = np.asarray(info.d, np.float64)
    if not np.any(coefficients != 0.0):
        return None
    if not (np.isfinite(coefficients).all() and np.isfinite(np.asarray(info.k, np.float64)).all()):
        raise ContractError(f'camera {camera}: camera_info is not finite')
    sizes = MODELS.get(info.distortion_model)
    if sizes is None:
        known = ', '.join(MODELS)
        raise ContractError(
            f'camera {camera}: distortion model {info.distortion_model!r} is not known (known: {known}); '
            'rectify its images first'
        )
    if len(coefficients) not in sizes:
        wanted = ' or '.join(map(str, sizes))
        raise ContractError(
            f'camera {camera}: {len(coefficients)} coefficients in D; {info.distortion_model} has {wanted}'
        )
    whole = ((0, 0, 0, 0), (0, 0, info.width, info.height))
    part = (info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height)
    if max(info.binning_x, info.binning_y) > 1 or part not in whole:
        raise ContractError(
            f'camera {camera}: lens distortion together with binning or a region of interest; rectify its images first'
        )
    width, height = int(info.width), int(info.height)
    intrinsics = np.asarray(info.k, np.float64).reshape(3, 3)
    if width <= 0 or height <= 0 or not (intrinsics[0, 0] > 0.0 and intrinsics[1, 1] > 0.0):
        raise ContractError(f'camera {camera} is uncalibrated: {height}x{width}, K[0] is {intrinsics[0, 0]:g}')
    return Lens(camera, info.distortion_model, width, height, intrinsics, coefficients)
