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
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import load_timing

GRAVITY_MPS2 = 9.81
STANDING_MPS = 0.3
BLIND_LEVELS = 8
# A rate may differ from the wanted one by this share.
RATE_SHARE = 0.1
CLOCK = 'clock: stamps'


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
        *_clock(seen),
        *_topics(seen, names),
        *_times(seen, names, cameras, compressed=compressed),
        *_frames(seen, cameras, compressed=compressed),
        *_cameras(seen, rig),
        *_motion(seen),
        *_route(seen),
        *_command(seen),
    ]


def _clock(seen: Observation) -> Iterator[Verdict]:
    if seen.sim_time:
        text = (
            f'{topics.CLOCK} is published: planner and gate need --sim-time'
            if not seen.wants_sim_time
            else topics.CLOCK
        )
        yield Verdict('clock: source', 'passed', text)
    elif seen.wants_sim_time:
        yield Verdict('clock: source', 'error', f'nobody publishes {topics.CLOCK}', 'publish it, or omit --sim-time')


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
            fix = 'reliability RELIABLE, or raw2drive drive --sensor-reliability best_effort'
            yield Verdict(check, 'error', 'best effort: reliable subscribers do not match', fix)
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
        yield _rate(name, spec.rate_hz, _rate_hz(stamps))
        back = sum(b <= a for a, b in itertools.pairwise(stamps))
        text = (
            f'{back} of {len(stamps)} are not later than the one before' if back else 'each later than the one before'
        )
        yield Verdict(f'{name}: stamps', 'error' if back else 'passed', text, 'stamp when measured' if back else '')
    yield from _ages(seen, names)
    images = topics.compressed_topic if compressed else topics.image_topic
    sets = [set(seen.topics.get(images(camera), TopicSeen()).stamps_ns) for camera in cameras]
    if all(sets):
        shared = set.intersection(*sets)
        share = len(shared) / max(map(len, sets))
        fine = share >= 0.9
        fix = '' if fine else 'trigger the cameras together and give them one stamp, or drive --camera-skew 0.02'
        text = f'{100 * share:.0f} % of the pictures have a partner in every camera'
        yield Verdict('cameras: one stamp for all', 'passed' if fine else 'error', text, fix)
        yield from _samples(seen, sorted(shared or sets[0]))


def _rate_hz(stamps: list[int]) -> float:
    return (len(stamps) - 1) / max((stamps[-1] - stamps[0]) * 1e-9, 1e-9)


def _multiple(rate: float, wanted: float) -> int:
    """How many times `wanted` a rate is, at least 1; 0 where it is no multiple."""
    times = max(1, round(rate / wanted))
    return times if abs(rate / (times * wanted) - 1.0) <= RATE_SHARE / times else 0


def _rate(name: str, wanted: float, rate: float) -> Verdict:
    check, text, times = f'{name}: rate', f'{rate:.1f} Hz', _multiple(rate, wanted)
    if times == 1:
        return Verdict(check, 'passed', text)
    motion = name in (topics.IMU, topics.ODOMETRY)
    if motion and rate > wanted:
        fix = f'more than needed: {wanted:g} Hz are enough, with a sample at every picture'
        return Verdict(check, 'warning', text, fix)
    if times:
        fix = f'the planner takes one picture in {times} by itself; {wanted:g} Hz would spare the others'
        return Verdict(check, 'warning', f'{text}, {times} times {wanted:g} Hz', fix)
    fix = f'{wanted:g} Hz by the stamps' + ('' if motion else ', or a whole multiple of it for cameras')
    return Verdict(check, 'error', text, fix)


def _ages(seen: Observation, names: list[str]) -> Iterator[Verdict]:
    """Age of the messages at arrival; one verdict for all where the clock itself must be the cause."""
    limit_s = load_timing().input_age_s
    ages = {
        name: float(np.median(seen.topics[name].ages_s))
        for name in names
        if topics.BY_NAME[name].rate_hz and not topics.BY_NAME[name].qos.latched
        if name in seen.topics and len(seen.topics[name].stamps_ns) >= 3
    }
    late = [name for name, age in ages.items() if age > limit_s]
    early = [name for name, age in ages.items() if age < -limit_s]
    for wrong, what, fix in (
        (
            late,
            'too old',
            'stamp when measured, by ROS time: clocks set, use_sim_time the same everywhere?',
        ),
        (early, 'in the future', 'clocks set, use_sim_time the same everywhere? A stamp is the time of measurement'),
    ):
        together = len(wrong) > max(2, len(ages) // 2)
        if together:
            age_ms = 1e3 * float(np.median([ages[name] for name in wrong]))
            yield Verdict(
                CLOCK, 'error', f'{age_ms:.0f} ms at arrival, {len(wrong)} of {len(ages)} topics: {what}', fix
            )
        for name in wrong:
            if not together:
                yield Verdict(f'{name}: age', 'error', f'{ages[name] * 1e3:.0f} ms at arrival: {what}', fix)
    for name, age in ages.items():
        if abs(age) <= limit_s:
            yield Verdict(f'{name}: age', 'passed', f'{age * 1e3:.0f} ms at arrival')


def _samples(seen: Observation, pictures: list[int]) -> Iterator[Verdict]:
    """Is there a sample of odometry and IMU at every picture (of those that the planner takes)?"""
    if len(pictures) < 3 or not (times := _multiple(_rate_hz(pictures), DECISION_HZ)):
        return
    for name in (topics.IMU, topics.ODOMETRY):
        stamps = seen.topics.get(name, TopicSeen()).stamps_ns
        inside = [stamp for stamp in pictures if stamps and min(stamps) <= stamp <= max(stamps)]
        if not inside:
            continue
        share = len(set(inside) & set(stamps)) / len(inside)
        fine = share >= 0.9 / times
        text = f'{100 * share:.0f} % of the pictures have a sample of the same stamp'
        fix = '' if fine else 'sample at the stamps of the pictures, or raw2drive drive --interpolate-age 0.05'
        yield Verdict(f'{name}: at the pictures', 'passed' if fine else 'warning', text, fix)


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
        if distortion := seen.distortion.get(wanted.name):
            text = f'lens distortion, D = {", ".join(f"{value:.3g}" for value in distortion)}'
            fix = 'the planner rectifies its pictures; this check cannot compare them. Better: publish rectified ones'
            yield Verdict(check, 'warning', text, fix)
        elif found is None:
            yield Verdict(check, 'error', 'not known', 'publish camera_info and extrinsics')
        elif (found.height, found.width) != (wanted.height, wanted.width):
            text = f'{found.height}x{found.width}, the bundle needs {wanted.height}x{wanted.width}'
            yield Verdict(check, 'error', text, 'crop and scale, or train a bundle for this rig')
        else:
            yield from _against_bundle(check, found, wanted)
        if image is None:
            continue
        check = f'camera {wanted.name}: picture'
        if image.shape[:2] != (wanted.height, wanted.width) and not distortion:
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
    right = not standing or abs(total - GRAVITY_MPS2) < 0.5
    if 0.8 < total < 1.2:
        yield Verdict('imu: units', 'error', text, 'm/s2, not g')
    elif total < 0.5:
        fix = 'gravity is missing: at rest an accelerometer reads +9.81 m/s2 on z (REP-145)'
        yield Verdict('imu: units', 'error', text, fix)
    elif not right:
        yield Verdict('imu: units', 'error', text, 'at rest an accelerometer reads 9.81 m/s2 (REP-145)')
    else:
        yield Verdict('imu: units', 'passed', text)
    if total < 0.5:
        yield Verdict('imu: axes', 'skipped', 'without gravity they cannot be told', 'mend "imu: units" first')
    elif standing:
        up = force[2] > 0.9 * total
        fix = '' if up else '+9.81 on z at rest, axes parallel to base_link (REP-103: x forward, y left, z up)'
        yield Verdict('imu: axes', 'passed' if up else 'error', text, fix)
    else:
        yield Verdict('imu: axes', 'skipped', 'the car moves', 'check again while it stands')
    if standing:
        rate = float(np.abs([sample.angular_velocity_radps for sample in seen.imu]).max())
        fix = '' if rate < 0.2 else 'rad/s, not degrees; remove the offset'
        yield Verdict('imu: at rest', 'passed' if rate < 0.2 else 'warning', f'turns at {rate:.3f} rad/s at most', fix)


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
