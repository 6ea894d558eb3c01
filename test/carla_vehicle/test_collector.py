"""Measurements of one frame, which arrive from threads in any order."""

import random
import threading

import pytest

from raw2drive_ros.carla_vehicle.collector import FrameCollector
from raw2drive_ros.contracts.errors import SensorTimeoutError

NAMES = ('imu', 'front', 'back')


def test_every_frame_is_complete_whatever_the_order() -> None:
    collector, rng = FrameCollector(NAMES, 5.0), random.Random(0)

    def report(name: str, order: list[int]) -> None:
        for frame in order:
            collector.put(name, frame, (name, frame))

    frames = list(range(100))
    orders = {name: sorted(frames, key=lambda frame: frame + 3 * rng.random()) for name in NAMES}
    threads = [threading.Thread(target=report, args=item) for item in orders.items()]
    for thread in threads:
        thread.start()
    for frame in frames:
        assert collector.take(frame) == {name: (name, frame) for name in NAMES}
    for thread in threads:
        thread.join()


def test_missing_sensors_are_named_and_late_measurements_are_dropped() -> None:
    collector = FrameCollector(NAMES, 0.05)
    collector.put('front', 4, 'picture')
    with pytest.raises(SensorTimeoutError, match=r'no measurement of frame 4 within 0.05 s from: imu, back'):
        collector.take(4)
    for name in NAMES:
        collector.put(name, 4, 'late')
        collector.put(name, 5, 'in time')
    with pytest.raises(SensorTimeoutError, match=r'frame 4 within 0.05 s from: imu, front, back'):
        collector.take(4)
    assert set(collector.take(5).values()) == {'in time'}
