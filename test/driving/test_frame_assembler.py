import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.contracts.public import ImuSample, OdometrySample
from raw2drive_ros.driving.frame_assembler import MOTION_LIMIT, PENDING_LIMIT, FrameAssembler

CAMERAS = ('front', 'back')
IMAGE = np.zeros((2, 2, 3), np.uint8)


def feed(assembler: FrameAssembler, kind: str, stamp: int):
    if kind == 'imu':
        return assembler.add_imu(ImuSample(stamp, (0, 0, 9.81), (0, 0, 0)))
    if kind == 'odometry':
        return assembler.add_odometry(OdometrySample(stamp, 0, 0, 0, 0, 0))
    return assembler.add_image(kind, stamp, IMAGE)


@given(st.permutations([*CAMERAS, 'imu', 'odometry']))
def test_any_order_completes_exactly_once(order) -> None:
    assembler = FrameAssembler(CAMERAS)
    frames = [feed(assembler, kind, 10) for kind in order]
    assert [f is not None for f in frames] == [False] * 3 + [True]
    assert set(frames[-1].images) == set(CAMERAS)


def test_a_missing_camera_gives_no_frame_and_is_counted() -> None:
    assembler = FrameAssembler(CAMERAS)
    for kind in ('front', 'imu', 'odometry'):
        assert feed(assembler, kind, 10) is None
    for kind in (*CAMERAS, 'imu', 'odometry'):
        last = feed(assembler, kind, 20)
    assert last.stamp_ns == 20
    assert assembler.incomplete == 1


def test_older_images_are_dropped() -> None:
    assembler = FrameAssembler(CAMERAS)
    for kind in (*CAMERAS, 'imu', 'odometry'):
        feed(assembler, kind, 20)
    feed(assembler, 'front', 10)
    assert assembler.late == 1
    assert 10 not in assembler.images


def test_memory_is_bounded() -> None:
    assembler = FrameAssembler(CAMERAS)
    for stamp in range(500):
        feed(assembler, 'front', stamp)
        feed(assembler, 'imu', stamp)
    assert len(assembler.images) <= PENDING_LIMIT
    assert len(assembler.imus) <= MOTION_LIMIT
