from raw2drive_ros.driving.health_report import HealthReport, Line
from raw2drive_ros.driving.sensor_monitor import SensorMonitor

SECOND = 1_000_000_000


def test_a_log_tells_waiting_from_breaking_and_says_when_all_is_well() -> None:
    monitor, report = SensorMonitor(('front',)), HealthReport()
    monitor.start(0)
    assert report.lines(monitor.findings(SECOND // 10)) == []
    waiting = 'waiting for camera front, imu, odometry: nothing heard yet'
    assert report.lines(monitor.findings(SECOND)) == [Line(False, waiting)]
    assert report.lines(monitor.findings(2 * SECOND)) == [], 'once is enough'
    for name in ('front', 'imu', 'odometry'):
        monitor.heard(name, 3 * SECOND, 3 * SECOND)
    assert report.lines(monitor.findings(3 * SECOND)) == [Line(False, 'nominal: all sensors are well')]
    for name in ('front', 'odometry'):
        monitor.heard(name, 4 * SECOND, 4 * SECOND)
    (line,) = report.lines(monitor.findings(4 * SECOND))
    assert line.alarming
    assert line.text.startswith('stop: imu: newest is 1.00 s old; ')


def test_an_input_that_never_came_is_alarming_when_others_broke() -> None:
    monitor, report = SensorMonitor(('front', 'back')), HealthReport()
    monitor.start(0)
    for name in ('back', 'imu', 'odometry'):
        monitor.heard(name, SECOND, SECOND)
    assert report.lines(monitor.findings(SECOND)) == [Line(False, 'waiting for camera front: nothing heard yet')]
    monitor.heard('back', 2 * SECOND, 2 * SECOND)
    monitor.heard('odometry', 2 * SECOND, 2 * SECOND)
    lines = report.lines(monitor.findings(2 * SECOND))
    assert [line.alarming for line in lines] == [True, True]
