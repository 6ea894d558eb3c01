"""Checks of a vehicle that only listen to it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from msg_adapters.sensors import BASE_FRAME, IMU_FRAME, MAP_FRAME, optical_frame
from raw2drive_ros.conformance.observation import Observation, TopicSeen, Verdict
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.timing import load_timing

GRAVITY_MPS2 = 9.81
STANDING_MPS = 0.3
BLIND_LEVELS = 8


def expected(cameras: tuple[str, ...], *, compressed: bool) -> list[str]:
    """The topics that a vehicle with these cameras publishes."""
    images = topics.compressed_topic if compressed else topics.image_topic
    found = [topics.IMU, topics.ODOMETRY, topics.ROUTE]
    for camera in cameras:
        found += [images(camera), topics.camera_info_topic(camera), topics.extrinsics_topic(camera)]
    return found


def judge(seen: Observation, rig: tuple[CameraCalibration, ...], *, compressed: bool = False) -> list[Verdict]:
    """All checks of what was observed. rig: the bundle's cameras."""
    cameras = tuple(camera.name for camera in rig)
    names = expected(cameras, compressed=compressed)
    return [
        *_topics(seen, names),
        *_times(seen, names, cameras, compressed=compressed),
        *_frames(seen, cameras, compressed=compressed),
        *_cameras(seen, rig),
        *_motion(seen),
        *_route(seen),
        *_command(seen),
    ]


def _topics(seen: Observation, names: list[str]) -> Iterator[Verdict]:
    for name in names:
        spec, topic = topics.BY_NAME[name], seen.topics.get(name, TopicSeen())
        check = f'{name}: publisher'
        if not topic.publishers:
            how = f'at {spec.rate_hz:g} Hz' if spec.rate_hz else 'once, latched (TRANSIENT_LOCAL)'
            yield Verdict(check, 'error', 'nobody publishes it', f'publish {spec.msgtype} {how}')
            continue
        if topic.publishers > 1:
            yield Verdict(check, 'error', f'{topic.publishers} publishers', 'stop all but one')
        elif topic.msgtypes != (spec.msgtype,):
            yield Verdict(check, 'error', f'it is {", ".join(topic.msgtypes)}', f'publish {spec.msgtype}')
        else:
            yield Verdict(check, 'passed', f'one, {spec.msgtype}')
        check = f'{name}: QoS'
        if spec.qos.latched and not topic.transient_local:
            yield Verdict(check, 'error', 'volatile: late subscribers never get it', 'durability TRANSIENT_LOCAL')
        elif spec.qos.reliable and not topic.reliable:
            yield Verdict(check, 'error', 'best effort: reliable subscribers do not match', 'reliability RELIABLE')
        else:
            yield Verdict(check, 'passed', 'matches')
        if topic.refused:
            text = f'{len(topic.refused)} messages break the contract: {topic.refused[0]}'
            yield Verdict(f'{name}: content', 'error', text, 'see docs/topics.md')


def _times(seen: Observation, names: list[str], cameras: tuple[str, ...], *, compressed: bool) -> Iterator[Verdict]:
    for name in names:
        spec, topic = topics.BY_NAME[name], seen.topics.get(name, TopicSeen())
        stamps = topic.stamps_ns
        if not spec.rate_hz or spec.qos.latched or not topic.publishers:
            continue
        if len(stamps) < 3:
            text = f'{len(stamps)} messages in {seen.seconds:.0f} s'
            yield Verdict(f'{name}: rate', 'error', text, 'keep publishing')
            continue
        rate = (len(stamps) - 1) / max((stamps[-1] - stamps[0]) * 1e-9, 1e-9)
        close = 0.9 <= rate / spec.rate_hz <= 1.1
        fix = f'{spec.rate_hz:g} Hz by the stamps'
        yield Verdict(f'{name}: rate', 'passed' if close else 'error', f'{rate:.1f} Hz', '' if close else fix)
        back = sum(b <= a for a, b in itertools.pairwise(stamps))
        text = (
            f'{back} of {len(stamps)} are not later than the one before' if back else 'each later than the one before'
        )
        yield Verdict(f'{name}: stamps', 'error' if back else 'passed', text, 'stamp when measured' if back else '')
        age = float(np.median(topic.ages_s))
        limit = load_timing().input_age_s
        old = abs(age) > limit
        fix = 'is use_sim_time the same everywhere, are the clocks set?' if old else ''
        yield Verdict(f'{name}: age', 'error' if old else 'passed', f'{age * 1e3:.0f} ms at arrival', fix)
    images = topics.compressed_topic if compressed else topics.image_topic
    sets = [set(seen.topics.get(images(camera), TopicSeen()).stamps_ns) for camera in cameras]
    if all(sets):
        shared = set.intersection(*sets)
        share = len(shared) / max(map(len, sets))
        fine = share >= 0.9
        fix = '' if fine else 'trigger the cameras together and give them one stamp'
        text = f'{100 * share:.0f} % of the pictures have a partner in every camera'
        yield Verdict('cameras: one stamp for all', 'passed' if fine else 'error', text, fix)


def _frames(seen: Observation, cameras: tuple[str, ...], *, compressed: bool) -> Iterator[Verdict]:
    images = topics.compressed_topic if compressed else topics.image_topic
    wanted = {topics.IMU: IMU_FRAME, topics.ODOMETRY: MAP_FRAME, topics.ROUTE: MAP_FRAME}
    wanted |= {images(camera): optical_frame(camera) for camera in cameras}
    wanted |= {topics.extrinsics_topic(camera): BASE_FRAME for camera in cameras}
    for name, frame in wanted.items():
        frames = seen.topics.get(name, TopicSeen()).frames
        if frames and frames != {frame}:
            yield Verdict(f'{name}: frame', 'warning', f'frame_id {", ".join(sorted(frames))}', f'frame_id {frame}')
        elif frames:
            yield Verdict(f'{name}: frame', 'passed', frame)


def _cameras(seen: Observation, rig: tuple[CameraCalibration, ...]) -> Iterator[Verdict]:
    for wanted in rig:
        found, image = seen.calibrations.get(wanted.name), seen.images.get(wanted.name)
        check = f'camera {wanted.name}: calibration'
        if found is None:
            yield Verdict(check, 'error', 'not known', 'publish camera_info and extrinsics')
        elif (found.height, found.width) != (wanted.height, wanted.width):
            text = f'{found.height}x{found.width}, the bundle needs {wanted.height}x{wanted.width}'
            yield Verdict(check, 'error', text, 'crop and scale, or train a bundle for this rig')
        else:
            yield from _against_bundle(check, found, wanted)
        if image is None:
            continue
        check = f'camera {wanted.name}: picture'
        if image.shape[:2] != (wanted.height, wanted.width):
            text = f'{image.shape[0]}x{image.shape[1]}, the bundle needs {wanted.height}x{wanted.width}'
            yield Verdict(check, 'error', text, 'images and camera_info must agree')
        elif int(image.max()) - int(image.min()) < BLIND_LEVELS:
            yield Verdict(check, 'error', 'without contrast', 'look at lens, exposure and cable')
        else:
            yield Verdict(check, 'passed', f'grey levels {image.min()} to {image.max()}')


def _against_bundle(check: str, found: CameraCalibration, wanted: CameraCalibration) -> Iterator[Verdict]:
    pixels = float(np.abs(found.intrinsics - wanted.intrinsics).max())
    moved = float(np.linalg.norm(found.base_from_camera[:3, 3] - wanted.base_from_camera[:3, 3]))
    cosine = (np.trace(found.base_from_camera[:3, :3].T @ wanted.base_from_camera[:3, :3]) - 1.0) / 2.0
    turned = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    same = pixels < 1e-6 and moved < 1e-6 and turned < 1e-3
    text = f"intrinsics {pixels:.2f} px, position {moved:.3f} m, direction {turned:.2f} degrees from the bundle's"
    fix = 'mount it as the bundle has it, or train a bundle for this rig: the planner refuses another one'
    yield Verdict(check, 'passed' if same else 'error', 'as in the bundle' if same else text, '' if same else fix)


def _motion(seen: Observation) -> Iterator[Verdict]:
    if not seen.imu or not seen.odometry:
        return
    standing = all(abs(sample.speed_mps) < STANDING_MPS for sample in seen.odometry)
    force = np.mean([sample.specific_force_mps2 for sample in seen.imu], axis=0)
    total = float(np.linalg.norm(force))
    text = f'mean specific force {force[0]:.2f}, {force[1]:.2f}, {force[2]:.2f} m/s2'
    if 0.8 < total < 1.2:
        yield Verdict('imu: units', 'error', text, 'm/s2, not g')
    elif standing and abs(total - GRAVITY_MPS2) > 0.5:
        yield Verdict('imu: units', 'error', text, 'at rest an accelerometer reads 9.81 m/s2 (REP-145)')
    else:
        yield Verdict('imu: units', 'passed', text)
    if standing:
        up = force[2] > 0.9 * total
        fix = '' if up else '+9.81 on z at rest, axes parallel to base_link (REP-103: x forward, y left, z up)'
        yield Verdict('imu: axes', 'passed' if up else 'error', text, fix)
        rate = float(np.abs([sample.angular_velocity_radps for sample in seen.imu]).max())
        fix = '' if rate < 0.2 else 'rad/s, not degrees; remove the offset'
        yield Verdict('imu: at rest', 'passed' if rate < 0.2 else 'warning', f'turns at {rate:.3f} rad/s at most', fix)
    else:
        yield Verdict('imu: axes', 'skipped', 'the car moves', 'check again while it stands')


def _route(seen: Observation) -> Iterator[Verdict]:
    if seen.route is None or not seen.odometry:
        return
    here = seen.odometry[-1]
    points = seen.route.checkpoints_m
    nearest = float(np.min(np.hypot(points[:, 0] - here.x_m, points[:, 1] - here.y_m)))
    near = nearest < 60.0
    fix = '' if near else 'route and odometry must share the frame `map`'
    yield Verdict('route: near the car', 'passed' if near else 'error', f'nearest checkpoint {nearest:.0f} m away', fix)


def _command(seen: Observation) -> Iterator[Verdict]:
    heard = seen.command_subscribers > 0
    fix = '' if heard else f'subscribe to {topics.COMMAND}'
    yield Verdict(f'{topics.COMMAND}: subscriber', 'passed' if heard else 'error', str(seen.command_subscribers), fix)
