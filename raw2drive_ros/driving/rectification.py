"""Pictures of a real lens, as the pinhole camera of a policy bundle would have taken them."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from msg_adapters.lens import Lens
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8

# Share of the bundle's picture that the lens may miss. The picture's edge is repeated there.
LARGEST_MISSING = 0.01
# Pixels of the lens's picture along each pixel of the bundle's: below this there is too little to see.
LEAST_PIXELS = 0.5
# Above one, that many samples are averaged along each side of a pixel, as a coarser sensor would do.
MOST_SAMPLES = 16


class Rectifier:
    """Turns the pictures of a lens into those of a pinhole camera; the maps are computed once.

    wanted: a camera of the bundle. The rectified pictures have its size and intrinsics; the optical frame, and with it
    the mounting, stays that of the lens (R and P of the CameraInfo are not used). Raises ContractError, in one line,
    for a lens that does not show what the bundle's camera shows.
    """

    def __init__(self, lens: Lens, wanted: CameraCalibration) -> None:
        self.lens, self.wanted = lens, wanted
        self.samples = 1
        maps = self._maps()
        pixels = self._check(*maps)
        self.samples = min(math.ceil(pixels - 0.25), MOST_SAMPLES) if pixels > 1.0 else 1
        self.maps = maps if self.samples == 1 else self._maps()

    def __str__(self) -> str:
        lens, wanted = self.lens, self.wanted
        return (
            f'camera {lens.camera}: lens distortion ({lens.model}); its {lens.height}x{lens.width} pictures are '
            f"rectified to the bundle's {wanted.height}x{wanted.width}"
        )

    def fits(self, lens: Lens) -> bool:
        """Whether this is the rectifier of that lens."""
        ours = self.lens
        same = (ours.camera, ours.model, ours.width, ours.height) == (lens.camera, lens.model, lens.width, lens.height)
        same = same and np.array_equal(ours.intrinsics, lens.intrinsics)
        return bool(same and np.array_equal(ours.coefficients, lens.coefficients))

    def calibration(self, base_from_camera: Float64) -> CameraCalibration:
        """The rectified camera, mounted where the lens is."""
        wanted = self.wanted
        return CameraCalibration(
            self.lens.camera, wanted.width, wanted.height, wanted.intrinsics, base_from_camera
        ).validate()

    def __call__(self, image: Image8) -> Image8:
        """(H, W, 3) uint8 of the lens -> (h, w, 3) uint8 of the bundle's camera. Raises ContractError for another
        size than the lens's."""
        lens, wanted = self.lens, self.wanted
        if image.shape[:2] != (lens.height, lens.width):
            raise ContractError(
                f'camera {lens.camera}: image {image.shape[0]}x{image.shape[1]}, its camera_info says '
                f'{lens.height}x{lens.width}'
            )
        pixels = np.ascontiguousarray(image)
        taken = cv2.remap(pixels, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if self.samples > 1:
            taken = cv2.resize(taken, (wanted.width, wanted.height), interpolation=cv2.INTER_AREA)
        return np.asarray(taken, np.uint8)

    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(x, y) in the lens's picture of every sample of the bundle's."""
        lens, wanted, n = self.lens, self.wanted, self.samples
        # Pixel centres are at whole numbers: n samples per side lie around each.
        finer = np.array([[n, 0.0, (n - 1) / 2], [0.0, n, (n - 1) / 2], [0.0, 0.0, 1.0]]) @ wanted.intrinsics
        size = (wanted.width * n, wanted.height * n)
        make = cv2.fisheye.initUndistortRectifyMap if lens.model == 'equidistant' else cv2.initUndistortRectifyMap
        x, y = make(lens.intrinsics, lens.coefficients, np.eye(3), finer, size, cv2.CV_32FC1)
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def _check(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> float:
        """Pixels of the lens's picture along a pixel of the bundle's. Raises ContractError."""
        lens = self.lens
        refused = f'camera {lens.camera}: its lens distortion ({lens.model}) cannot be rectified to the bundle: '
        x_down, x_right = np.gradient(x.astype(np.float64))
        y_down, y_right = np.gradient(y.astype(np.float64))
        area = x_right * y_down - x_down * y_right
        if not (np.isfinite(area).all() and area.min() > 0.0):
            raise ContractError(refused + 'D turns the edge of the picture inside out; calibrate the lens again')
        seen = (x >= -0.5) & (x <= lens.width - 0.5) & (y >= -0.5) & (y <= lens.height - 0.5)
        missing = 1.0 - float(seen.mean())
        if missing > LARGEST_MISSING:
            raise ContractError(
                f'{refused}{100 * missing:.0f} % of what the bundle sees lies outside of its picture '
                f'({100 * LARGEST_MISSING:.0f} % may); use a wider lens, or train a bundle for this rig'
            )
        pixels = math.sqrt(float(np.median(area)))
        if pixels < LEAST_PIXELS:
            raise ContractError(
                f'{refused}{pixels:.2f} pixels to each side of a pixel there ({LEAST_PIXELS:g} are needed); '
                'use a higher resolution'
            )
        return pixels
