"""Sensors that share no trigger: interpolation, skewed cameras, and one decision per period."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.public import ImuSample, OdometrySample
from raw2drive_ros.driving.frame_assembler import PENDING_LIMIT, FrameAssembler
from raw2drive_ros.driving.synchronisation import EARLY_NS, Synchronisation, between, is_due, sample_at
from raw2drive_ros.tables.rates import DECISION_NS

MS = 1_000_000
CAMERAS = ('front', 'back')
IMAGE = np.zeros((2, 2, 3), np.uint8)


def imu(stamp_ns: int, force: float = 0.0) -> ImuSample:
    return ImuSample(stamp_ns, (force, 0.0, 9.81), (0.0, 0.0, force / 8))


def odometry(stamp_ns: int, x: float = 0.0, yaw: float = 0.0) -> OdometrySample:
    return OdometrySample(stamp_ns, x, -x, yaw, 5.0 + x, 0.5)


def test_between_two_samples_everything_is_linear() -> None:
    found = between(odometry(0, 1.0, 0.2), odometry(100, 3.0, 0.6), 0.25, 25)
    assert found == OdometrySample(25, 1.5, -1.5, pytest.approx(0.3), 6.5, 0.5)
    assert between(imu(0, 2.0), imu(100, 4.0), 0.5, 50) == ImuSample(50, (3.0, 0.0, 9.81), (0.0, 0.0, 0.375))


@given(st.floats(-math.pi, math.pi), st.floats(-3.0, 3.0), st.floats(0.0, 1.0))
def test_yaw_goes_the_shorter_way_round(yaw, turn, share) -> None:
    """Also across the border at pi, where the plain mean of two headings points backwards."""
    after = math.remainder(yaw + turn, math.tau)
    found = between(odometry(0, yaw=yaw), odometry(100, yaw=after), share, 50).yaw_rad
    assert abs(found) <= math.pi
    assert math.remainder(found - (yaw + share * turn), math.tau) == pytest.approx(0.0, abs=1e-9)


def test_a_sample_of_the_stamp_itself_is_taken_as_it_is() -> None:
    samples = {stamp: odometry(stamp, stamp) for stamp in (0, 50, 100)}
    assert sample_at(samples, 50, 100) is samples[50]
    assert sample_at(samples, 50, 0) is samples[50]


@pytest.mark.parametrize(('stamp', 'age', 'found'), [(60, 40, True), (60, 39, False), (60, 0, False), (120, 99, False)])
def test_both_neighbours_have_to_be_within_the_stated_age(stamp, age, found) -> None:
    samples = {50: odometry(50), 100: odometry(100)}
    assert (sample_at(samples, stamp, age) is not None) == found


@pytest.mark.parametrize('field', ['interpolate_age_s', 'camera_skew_s'])
@pytest.mark.parametrize('value', [-0.01, 1.0, math.nan, math.inf])
def test_an_age_that_makes_no_sense_is_refused(field, value) -> None:
    with pytest.raises(ConfigError, match=field):
        Synchronisation(**{field: value})


@given(st.integers(1, 49), st.permutations(['front', 'back', 'imu', 'odometry']))
def test_a_frame_waits_for_the_samples_after_it(phase_ms, order) -> None:
    """Motion at 20 Hz beside the pictures' stamp: whatever comes last completes the frame, and it comes only once."""
    assembler = FrameAssembler(CAMERAS, Synchronisation(interpolate_age_s=0.05))
    frames = []
    for kind in order:
        if kind in CAMERAS:
            frames.append(assembler.add_image(kind, 100 * MS, IMAGE))
            continue
        for stamp_ms in (50 + phase_ms, 100 + phase_ms):
            if kind == 'imu':
                frames.append(assembler.add_imu(imu(stamp_ms * MS, stamp_ms)))
            else:
                frames.append(assembler.add_odometry(odometry(stamp_ms * MS, stamp_ms)))
    assert [frame is not None for frame in frames] == [False] * (len(frames) - 1) + [True]
    assert frames[-1].stamp_ns == frames[-1].imu.stamp_ns == frames[-1].odometry.stamp_ns == 100 * MS
    assert frames[-1].imu.specific_force_mps2[0] == pytest.approx(100.0)
    assert frames[-1].odometry.x_m == pytest.approx(100.0)


def test_every_picture_of_a_free_running_rig_gets_its_frame() -> None:
    """IMU at 100 Hz, odometry at 20 Hz, both off the pictures' stamps; pictures arrive 30 ms late."""
    assembler = FrameAssembler(CAMERAS, Synchronisation(interpolate_age_s=0.05))
    arrivals = [(t + 3, 'imu', t + 3) for t in range(0, 2000, 10)]
    arrivals += [(t + 7, 'odometry', t + 7) for t in range(0, 2000, 50)]
    arrivals += [(t + 30, camera, t) for t in range(100, 1900, 100) for camera in CAMERAS]
    frames = []
    for _, kind, stamp_ms in sorted(arrivals):
        add = {'imu': assembler.add_imu, 'odometry': assembler.add_odometry}.get(kind)
        if add is None:
            frame = assembler.add_image(kind, stamp_ms * MS, IMAGE)
        else:
            frame = add(imu(stamp_ms * MS, stamp_ms) if kind == 'imu' else odometry(stamp_ms * MS, stamp_ms))
        frames += [frame] if frame is not None else []
    assert [frame.stamp_ns // MS for frame in frames] == list(range(100, 1900, 100))
    assert all(frame.imu.specific_force_mps2[0] == pytest.approx(frame.stamp_ns / MS) for frame in frames)
    assert assembler.incomplete == 0


@given(st.lists(st.tuples(st.integers(0, 30), st.booleans()), min_size=1, max_size=8))
def test_pictures_within_the_skew_are_one_frame_of_the_earliest_stamp(ticks) -> None:
    assembler = FrameAssembler(CAMERAS, Synchronisation(camera_skew_s=0.03))
    for number, (skew_ms, swapped) in enumerate(ticks):
        early = 100 * (number + 1) * MS
        pictures = [('front', early), ('back', early + skew_ms * MS)]
        assembler.add_imu(imu(early))
        assembler.add_odometry(odometry(early))
        frames = [assembler.add_image(name, stamp, IMAGE) for name, stamp in (pictures[::-1] if swapped else pictures)]
        # The later picture first: the set gets its stamp from the one that follows.
        assert frames[0] is None
        assert frames[1].stamp_ns == early
    assert assembler.incomplete == assembler.late == 0


def test_pictures_further_apart_than_the_skew_are_no_frame() -> None:
    assembler = FrameAssembler(CAMERAS, Synchronisation(camera_skew_s=0.03))
    for tick in range(1, 20):
        for stamp, add in ((100 * tick, assembler.add_imu), (100 * tick + 40, assembler.add_imu)):
            add(imu(stamp * MS))
        assembler.add_odometry(odometry(100 * tick * MS))
        assert assembler.add_image('front', 100 * tick * MS, IMAGE) is None
        assert assembler.add_image('back', (100 * tick + 40) * MS, IMAGE) is None
    assert len(assembler.images) <= PENDING_LIMIT
    assert 'back at the stamp' in assembler.lacks() or 'front at the stamp' in assembler.lacks()


@pytest.mark.parametrize('hz', [10, 20, 30, 40, 50, 60])
@pytest.mark.parametrize('offset_ns', [0, 7_777_777])
def test_of_a_faster_camera_ten_pictures_a_second_are_decided_upon(hz, offset_ns) -> None:
    taken = None
    decided = []
    for number in range(10 * hz):
        stamp_ns = offset_ns + round(number * 1e9 / hz)
        if is_due(stamp_ns, taken):
            taken = stamp_ns
            decided.append(stamp_ns)
    assert len(decided) == 100
    assert np.ptp(np.diff(decided)) <= 2


@given(st.lists(st.integers(1, 150 * MS), min_size=2, max_size=80))
def test_decisions_are_a_period_apart_whatever_comes(gaps_ns) -> None:
    taken = None
    for stamp_ns in np.cumsum(gaps_ns).tolist():
        if is_due(stamp_ns, taken):
            assert taken is None or stamp_ns - taken >= DECISION_NS - EARLY_NS
            taken = stamp_ns


def test_what_is_not_later_than_the_last_decision_is_not_decimated() -> None:
    """A tick that is sent again, and a late one, which is counted elsewhere."""
    assert is_due(100, 100)
    assert is_due(50, 100)
    assert not is_due(101, 100)
