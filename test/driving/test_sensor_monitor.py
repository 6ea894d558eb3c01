"""Sensor data that is not fit for driving: each fault and its health; healthy sensors give no findings."""

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.public import ImuSample, OdometrySample, SensorFrame
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.sensor_monitor import Health, MonitorLimits, SensorMonitor
from raw2drive_ros.timing import load_timing

CAMERAS = ('front', 'back')
TICK_NS = 100_000_000
RNG = np.random.default_rng(0)


def picture() -> np.ndarray:
    return RNG.integers(0, 255, (32, 48, 3), np.uint8)


def feed(monitor: SensorMonitor, tick: int, speed_mps: float = 5.0, leave_out: str = '', **images) -> None:
    """One tick of all inputs; images by camera name replace the random ones."""
    stamp_ns = tick * TICK_NS
    for name in (*CAMERAS, 'imu', 'odometry'):
        if name != leave_out:
            assert monitor.heard(name, stamp_ns, stamp_ns)
    if not leave_out:
        shown = {camera: images.get(camera, picture()) for camera in CAMERAS}
        imu = ImuSample(stamp_ns, (0.0, 0.0, 9.81), (0.0,) * 3)
        monitor.frame(SensorFrame(stamp_ns, shown, imu, OdometrySample(stamp_ns, 0, 0, 0, speed_mps, 0)))


def started(ticks: int = 12) -> SensorMonitor:
    monitor = SensorMonitor(CAMERAS)
    monitor.start(0)
    for tick in range(ticks):
        feed(monitor, tick)
    assert monitor.findings((ticks - 1) * TICK_NS) == []
    return monitor


def only(monitor: SensorMonitor, tick: float):
    (finding,) = monitor.findings(round(tick * TICK_NS))
    assert finding.remedy
    return finding


def test_the_shipped_file_equals_the_defaults_of_the_class() -> None:
    assert load_monitor_config().limits(load_timing()) == MonitorLimits()


def test_a_wrong_file_names_its_field(tmp_path) -> None:
    (tmp_path / 'monitor.yaml').write_text('blind_levels: 300')
    with pytest.raises(ConfigError, match=r'monitor.yaml: blind_levels'):
        load_monitor_config(tmp_path / 'monitor.yaml')


def test_nothing_is_wrong_before_the_start() -> None:
    assert SensorMonitor(CAMERAS).findings(10**12) == []


@pytest.mark.parametrize('name', [*CAMERAS, 'imu', 'odometry'])
def test_one_silent_input_stops_and_is_named(name) -> None:
    monitor = started()
    for tick in range(12, 16):
        feed(monitor, tick, leave_out=name)
    assert monitor.findings(14 * TICK_NS) == []
    finding = only(monitor, 15)
    assert finding.health is Health.STOP
    assert finding.cause == f'{"camera " if name in CAMERAS else ""}{name}: newest is 0.40 s old'


def test_inputs_that_never_came_are_silent_from_the_start() -> None:
    monitor = SensorMonitor(CAMERAS)
    monitor.start(5 * TICK_NS)
    assert monitor.findings(8 * TICK_NS) == []
    causes = [finding.cause for finding in monitor.findings(9 * TICK_NS)]
    assert causes[0] == 'camera front: silent for 0.40 s'
    assert len(causes) == 4


def test_stamps_ahead_of_the_clock_stop() -> None:
    monitor = started()
    assert monitor.findings(8 * TICK_NS) == []
    found = monitor.findings(7 * TICK_NS)
    assert {f.health for f in found} == {Health.STOP}
    assert found[0].cause == 'camera front: stamps are 0.40 s ahead of ROS time'


@pytest.mark.parametrize('name', [*CAMERAS, 'imu', 'odometry'])
def test_one_future_stamp_costs_one_message(name) -> None:
    monitor = started()
    assert monitor.heard(name, 14 * TICK_NS, 11 * TICK_NS), 'a clock may come a little later than what it stamps'
    assert not monitor.heard(name, 36_000 * TICK_NS, 14 * TICK_NS)
    (found,) = monitor.findings(12 * TICK_NS)
    assert found.health is Health.STOP
    assert found.cause.endswith(f'{name}: stamps are 3598.60 s ahead of ROS time')
    assert monitor.heard(name, 15 * TICK_NS, 15 * TICK_NS)
    assert monitor.findings(12 * TICK_NS) == []
    assert monitor.counts == {f'{name}_early': 1}


@pytest.mark.parametrize(('value', 'shade'), [(0, 'black'), (255, 'white')])
def test_a_blind_camera_stops_after_three_frames(value, shade) -> None:
    monitor = started()
    blind = np.full((32, 48, 3), value, np.uint8)
    blind[::8] = abs(value - 7)
    for tick in (12, 13):
        feed(monitor, tick, front=blind + 0)
        assert monitor.findings(tick * TICK_NS) == []
    feed(monitor, 14, front=blind)
    assert only(monitor, 14).cause == f'camera front: {shade} for 3 frames'
    assert only(monitor, 14).health is Health.STOP
    feed(monitor, 15)
    assert monitor.findings(15 * TICK_NS) == []


def test_a_dark_picture_with_something_in_it_is_not_blind() -> None:
    monitor = started()
    dark = np.zeros((32, 48, 3), np.uint8)
    for tick in range(12, 20):
        dark[4 * (tick % 4)] = 8
        feed(monitor, tick, front=dark)
        assert monitor.findings(tick * TICK_NS) == []


@pytest.mark.parametrize(('speed', 'stops'), [(1.1, True), (-1.1, True), (1.0, False)])
def test_a_frozen_picture_stops_a_moving_car(speed, stops) -> None:
    monitor = started()
    frozen = picture()
    for tick in range(12, 17):
        feed(monitor, tick, speed, back=frozen)
        assert monitor.findings(tick * TICK_NS) == []
    feed(monitor, 17, speed, back=frozen)
    if stops:
        assert only(monitor, 17).cause == 'camera back: the same picture 6 times while driving'
        assert only(monitor, 17).health is Health.STOP
        feed(monitor, 18, speed)
    assert monitor.findings(18 * TICK_NS) == []


def test_a_plain_horizon_may_stay_the_same() -> None:
    monitor = started()
    horizon = np.repeat(np.linspace(0, 200, 32).astype(np.uint8)[:, None, None], 48, 1).repeat(3, 2)
    for tick in range(12, 25):
        feed(monitor, tick, front=horizon)
        assert monitor.findings(tick * TICK_NS) == []


@pytest.mark.parametrize(
    ('lost', 'health', 'rate'),
    [(1, None, ''), (2, Health.DEGRADED, '8.3 Hz'), (5, Health.DEGRADED, '6.7 Hz'), (6, Health.STOP, '6.2 Hz')],
)
def test_slow_camera_sets_degrade_and_then_stop(lost, health, rate) -> None:
    monitor = SensorMonitor(CAMERAS)
    gaps = [2] * lost + [1] * (10 - lost)
    tick = 0
    feed(monitor, tick)
    for gap in gaps:
        assert monitor.findings(tick * TICK_NS) == []
        tick += gap
        feed(monitor, tick)
    if health is None:
        assert monitor.findings(tick * TICK_NS) == []
        return
    finding = only(monitor, tick)
    assert finding.health is health
    assert finding.cause == f'camera sets: {rate} instead of 10'


@pytest.mark.parametrize(
    ('force', 'rate', 'cause'), [(80.0, 1.0, 'specific force 81 m/s2'), (0.0, -11.0, 'angular velocity 11 rad/s')]
)
def test_an_absurd_reading_degrades_and_five_in_a_row_stop(force, rate, cause) -> None:
    monitor = started()
    absurd = ImuSample(0, (0.0, force, 9.8), (0.0, 0.0, rate))
    for _ in range(4):
        monitor.imu(absurd)
    assert only(monitor, 11).health is Health.DEGRADED
    assert only(monitor, 11).cause == f'imu: {cause}, 4 times in a row'
    monitor.imu(absurd)
    assert only(monitor, 11).health is Health.STOP
    monitor.imu(ImuSample(0, (3.0, 0.0, 9.8), (0.0, 0.0, 1.0)))
    assert monitor.findings(11 * TICK_NS) == []
    assert monitor.counts == {'imu_absurd': 5}


def test_a_refused_message_degrades_for_a_second_and_explains_silence() -> None:
    monitor = started()
    monitor.refused('imu', 'not finite', 11 * TICK_NS)
    assert only(monitor, 11).health is Health.DEGRADED
    assert only(monitor, 11).cause == 'imu: refused: not finite'
    for tick in range(12, 22):
        feed(monitor, tick, leave_out='imu')
    found = monitor.findings(21 * TICK_NS)
    assert [f.health for f in found] == [Health.STOP, Health.DEGRADED]
    assert found[0].cause == 'imu: newest is 1.00 s old; refused: not finite'
    assert [f.health for f in monitor.findings(22 * TICK_NS)] == [Health.STOP]
    assert monitor.counts == {'imu_refused': 1}


def test_messages_out_of_order_are_not_used_and_counted() -> None:
    monitor = started()
    assert not monitor.heard('front', 10 * TICK_NS, 11 * TICK_NS)
    assert monitor.heard('front', 11 * TICK_NS, 11 * TICK_NS), 'the same tick again'
    assert monitor.counts == {'front_out_of_order': 1}


def test_a_reset_forgets_everything_but_the_counts() -> None:
    monitor = started()
    monitor.heard('front', 0, 11 * TICK_NS)
    monitor.refused('imu', 'x', 11 * TICK_NS)
    blind = np.zeros((32, 48, 3), np.uint8)
    for tick in range(12, 15):
        feed(monitor, tick, front=blind)
    monitor.reset()
    assert monitor.findings(14 * TICK_NS) == []
    assert monitor.heard('front', 0, 11 * TICK_NS)
    assert monitor.counts == {'front_out_of_order': 1, 'imu_refused': 1}
