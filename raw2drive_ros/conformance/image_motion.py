"""Does each camera see the ground move as its calibration and the odometry's pose say? Which other camera would?

A picture is predicted from an earlier one: the ground near the car is a plane, so K, mounting and motion tell for each
pixel where it was. The prediction is compared with the picture by correlation of local contrast, under several
assumptions about the camera: as declared, upside down, mirrored, with another lens, one of the others, standing still.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.conformance.observation import Grey, Observation, Verdict
from raw2drive_ros.conformance.views import LENSES, Move, ground_plane, mirrored, other_lens, turned_round
from raw2drive_ros.contracts.public import CameraCalibration, Float64

# Pictures are compared at this width at most: the motion is large, and memory and time are not.
WIDTH_PX = 160
# Two pictures between which the car has driven or turned so far, within this time.
DRIVEN_M, TURNED_RAD, APART_S = 1.6, 0.16, 1.6
PAIRS, LEAST_PAIRS = 12, 4
# Neighbouring columns say much the same.
COLUMN_STEP = 2
# The ground is compared up to here; further away it hardly moves.
NEAR_M = 12.0
BORDER_PX, LEAST_PIXELS = 2, 100
# Local contrast: width of the blur that removes noise, width of the neighbourhood, grey levels that count as noise.
FINE_PX, COARSE_PX, NOISE_LEVELS = 1.0, 4.0, 3.0
# Share of the pixels that must have contrast for the correlation to reach one.
TEXTURE = 0.05
# Correlation from which on a camera is recognised, and by how much another assumption must be better than the declared.
SURE, BETTER, BETTER_LENS = 0.45, 0.15, 0.1
LENS_SHARE = 0.08
Contrast = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Pair:
    """A picture, an earlier one, and the motion of `base_link` from this one back to the earlier one."""

    now: Contrast
    earlier: Contrast
    back: Move


@dataclass(frozen=True, slots=True)
class Fit:
    """How well an assumption about a camera explains its pictures. kind: declared, upside down, mirrored, lens, camera,
    still. score: correlation, at most 1. factor: of the focal length. other: name of the camera."""

    kind: str
    score: float
    factor: float = 1.0
    other: str = ''


def shrunk(image: Grey) -> Grey:
    """(H, W) grey picture of at most `WIDTH_PX` columns."""
    height, width = image.shape
    if width <= WIDTH_PX:
        return image
    size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def fits(seen: Observation, cameras: dict[str, CameraCalibration]) -> dict[str, list[Fit]]:
    """All assumptions about each of `cameras`, the best first; an empty list where the car has not moved enough.

    cameras: those to examine, which are also those that may have been exchanged.
    """
    found = {}
    for name, camera in cameras.items():
        pictures = seen.pictures.get(name, [])
        pairs = _pairs(seen, pictures)
        if len(pairs) < LEAST_PAIRS:
            found[name] = []
            continue
        small = _scaled(camera, pictures[0][1].shape)
        others = [_scaled(other, pictures[0][1].shape) for key, other in cameras.items() if key != name]
        found[name] = sorted(_assumptions(small, others, pairs), key=lambda fit: -fit.score)
    return found


def _assumptions(camera: CameraCalibration, others: list[CameraCalibration], pairs: list[Pair]) -> Iterator[Fit]:
    yield Fit('declared', correlation(camera, pairs))
    yield Fit('upside down', correlation(turned_round(camera), pairs))
    yield Fit('mirrored', correlation(mirrored(camera), pairs))
    yield Fit('still', correlation(camera, [replace(pair, back=Move(0.0, 0.0, 0.0)) for pair in pairs]))
    for other in others:
        yield Fit('camera', correlation(other, pairs), other=other.name)
    lenses = [Fit('lens', correlation(other_lens(camera, f), pairs), f) for f in LENSES]
    best = max(lenses, key=lambda fit: fit.score)
    if best.factor == 1.0:
        yield best
        return
    finer = best.factor * np.exp(np.linspace(-0.06, 0.06, 7))
    yield max((Fit('lens', correlation(other_lens(camera, f), pairs), float(f)) for f in finer), key=lambda x: x.score)


def correlation(camera: CameraCalibration, pairs: list[Pair]) -> float:
    """How well `camera` predicts the near ground of each picture from the earlier one: 1 perfectly, 0 not at all."""
    height, width = pairs[0].now.shape
    columns, rows = np.meshgrid(np.arange(0, width, COLUMN_STEP), np.arange(height))
    pixels = np.stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    pixel_from_ground = ground_plane(camera)
    ground = np.linalg.inv(pixel_from_ground) @ np.vstack([pixels, np.ones(pixels.shape[1])])
    # In front of the camera the last row is positive; near the horizon it vanishes.
    ahead = ground[2] > 1e-6
    ground = ground[:2, ahead] / ground[2, ahead]
    near = np.hypot(*(ground - camera.base_from_camera[:2, 3:])) < NEAR_M
    ground = np.vstack([ground[:, near], np.ones(int(near.sum()))])
    chosen = (rows * width + columns).ravel()[ahead][near]
    both = own = earlier = count = 0.0
    for pair in pairs:
        source = pixel_from_ground @ pair.back.matrix @ ground
        with np.errstate(divide='ignore', invalid='ignore'):
            source = np.where(source[2] > 1e-6, source[:2] / source[2], -1.0)
        inside = (source >= BORDER_PX).all(axis=0) & (source[0] < width - BORDER_PX) & (source[1] < height - BORDER_PX)
        if inside.sum() < LEAST_PIXELS:
            continue
        x, y = (part[inside].astype(np.float32)[:, None] for part in source)
        was = cv2.remap(pair.earlier, x, y, cv2.INTER_LINEAR)[:, 0]
        now = pair.now.reshape(-1)[chosen[inside]]
        both, own, earlier = both + float(now @ was), own + float(now @ now), earlier + float(was @ was)
        count += float(inside.sum())
    least = TEXTURE * count
    return both / math.sqrt((own + least) * (earlier + least)) if count else 0.0


def _pairs(seen: Observation, pictures: list[tuple[int, Grey]]) -> list[Pair]:
    """Pairs of pictures between which the car has moved, from the whole recording."""
    if len(pictures) < 2 or len(seen.odometry) < 2:
        return []
    poses = _poses(seen, np.array([stamp for stamp, _ in pictures], np.float64))
    found = []
    for now in range(1, len(pictures)):
        for before in range(now - 1, -1, -1):
            if pictures[now][0] - pictures[before][0] > APART_S * 1e9:
                break
            back = _move(poses[now], poses[before])
            if math.hypot(back.x_m, back.y_m) > DRIVEN_M or abs(back.yaw_rad) > TURNED_RAD:
                found.append((now, before, back))
                break
    step = max(1, math.ceil(len(found) / PAIRS))
    contrast = {i: local_contrast(pictures[i][1]) for chosen in found[::step] for i in chosen[:2]}
    return [Pair(contrast[now], contrast[before], back) for now, before, back in found[::step]]


def local_contrast(image: Grey) -> Contrast:
    """(H, W) float32: deviation from the neighbourhood, in units of the neighbourhood's own deviation."""
    fine = cv2.GaussianBlur(image.astype(np.float32), (0, 0), FINE_PX)
    deviation = fine - cv2.GaussianBlur(fine, (0, 0), COARSE_PX)
    spread = cv2.GaussianBlur(deviation * deviation, (0, 0), COARSE_PX)
    return np.asarray(deviation / np.sqrt(spread + NOISE_LEVELS**2), np.float32)


def _poses(seen: Observation, times_ns: Float64) -> Float64:
    """(N, 3) x, y, yaw of the car at these times, between the samples of odometry."""
    samples = sorted(seen.odometry, key=lambda sample: sample.stamp_ns)
    stamps = np.array([sample.stamp_ns for sample in samples], np.float64)
    data = np.array([(sample.x_m, sample.y_m, sample.yaw_rad) for sample in samples])
    data[:, 2] = np.unwrap(data[:, 2])
    return np.column_stack([np.interp(times_ns, stamps, data[:, axis]) for axis in range(3)])


def _move(first: Float64, then: Float64) -> Move:
    """The pose `then` in the axes of the pose `first`."""
    (dx, dy), yaw = then[:2] - first[:2], float(first[2])
    cos, sin = math.cos(yaw), math.sin(yaw)
    return Move(float(dx * cos + dy * sin), float(dy * cos - dx * sin), float(then[2] - first[2]))


def _scaled(camera: CameraCalibration, shape: tuple[int, ...]) -> CameraCalibration:
    """The camera as if it had pictures of this (H, W)."""
    height, width = int(shape[0]), int(shape[1])
    scale = np.diag([width / camera.width, height / camera.height, 1.0])
    return replace(camera, width=width, height=height, intrinsics=scale @ camera.intrinsics)


def explain(found: list[Fit]) -> Fit | None:
    """The assumption that the pictures of a camera ask for, best first in `found`; None when nothing can be told."""
    if not found or found[0].score < SURE:
        return None
    declared = next(fit for fit in found if fit.kind == 'declared')
    for fit in found:
        gain = fit.score - declared.score
        if fit.kind == 'lens' and gain > BETTER_LENS and abs(math.log(fit.factor)) > LENS_SHARE:
            return fit
        if fit.kind != 'lens' and gain > BETTER:
            return fit
    return declared if declared.score >= SURE else None


REMEDIES = {
    'upside down': 'the picture is upside down: turn it by 180 degrees, or say so in the extrinsics',
    'mirrored': 'the picture is mirrored: left and right are exchanged inside it',
    'lens': 'pictures and K are of different lenses or crops: calibrate again, at the size that is published',
    'still': 'the picture stands still while the car drives: is the same one sent again and again?',
}


def judge_pictures(seen: Observation, wrong: set[str]) -> Iterator[Verdict]:
    """A verdict per camera, and one for cameras that are exchanged. wrong: cameras with a wrong calibration."""
    results = {name: explain(found) for name, found in fits(seen, seen.calibrations).items()}
    told: set[str] = set()
    for name, fit in results.items():
        check = f'camera {name}: motion of the picture'
        if name in told:
            continue
        if fit is None:
            yield Verdict(check, 'skipped', 'cannot tell: too little motion or contrast', 'look at the mosaic')
            continue
        text = f'correlation {fit.score:.2f}'
        if fit.kind == 'declared':
            yield Verdict(check, 'passed', f'{text} with what K, mounting and odometry predict')
        elif name in wrong:
            yield Verdict(check, 'skipped', f'{text}, if {_assumed(fit)}', 'mend its calibration first')
        elif fit.kind == 'camera':
            back = results.get(fit.other)
            mutual = back is not None and (back.kind, back.other) == ('camera', name)
            told |= {fit.other} if mutual else set()
            which = f'cameras {name} and {fit.other}: exchanged' if mutual else check
            fix = 'exchange their topics (or cables): each sends the pictures of the other'
            fix = fix if mutual else f'it sends the pictures of camera {fit.other}'
            yield Verdict(which, 'error', f'{text}, if {_assumed(fit)}', fix)
        else:
            yield Verdict(check, 'error', f'{text}, if {_assumed(fit)}', REMEDIES[fit.kind])


def _assumed(fit: Fit) -> str:
    if fit.kind == 'lens':
        return f'the focal length is {fit.factor:.2f} times that of K'
    if fit.kind == 'camera':
        return f'it is the picture of {fit.other}'
    return {'still': 'it does not move'}.get(fit.kind, f'it is {fit.kind}')
