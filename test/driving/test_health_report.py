from raw2drive_ros.driving.health_report import HealthReport, Line
from raw2drive_ros.driving.sensor_monitor import SensorMonitor

SECOND = 1_000_000_000
INPUTS = ('front', 'imu', 'odometry')
WELL = [Line(alarming=False, text='nominal: all sensors are well')]


class MonitoredInputs:
    """A sensor monitor together with its log lines."""

    def __init__(self) -> None:
        self.monitor, self.report = SensorMonitor(('front',)), HealthReport()
        self.monitor.start(0)

    def hear(self, time_s: float, names: tuple[str, ...] = INPUTS) -> list[Line]:
        now_ns = round(time_s * SECOND)
        for name in names:
            self.monitor.heard(name, now_ns, now_ns)
        return self.report.lines(self.monitor.findings(now_ns), complete=self.monitor.complete)


def test_waiting_failures_and_recovery_are_logged_each_in_its_way() -> None:
    inputs = MonitoredInputs()
    assert inputs.hear(0.1, ()) == []
    waiting = Line(alarming=False, text='waiting for camera front, imu, odometry: nothing heard yet')
    assert inputs.hear(1.0, ()) == [waiting]
    assert inputs.hear(2.0, ()) == [], 'reported only once'
    assert inputs.hear(3.0) == WELL
    assert inputs.hear(3.1) == []
    (line,) = inputs.hear(4.0, ('front', 'odometry'))
    assert line.alarming
    assert line.text.startswith('stop: imu: newest is 0.90 s old; ')
    assert inputs.hear(4.1) == WELL


def test_healthy_sensors_are_reported_even_if_nothing_was_ever_wrong() -> None:
    assert MonitoredInputs().hear(0.1) == WELL


def test_an_input_never_heard_is_a_failure_as_soon_as_others_arrive() -> None:
    (line,) = MonitoredInputs().hear(1.0, ('front', 'odometry'))
    assert line.alarming
    assert line.text.startswith('stop: imu: silent for 1.00 s; ')


def test_after_a_time_jump_a_dead_camera_is_still_dead_and_not_unheard() -> None:
    inputs = MonitoredInputs()
    assert inputs.hear(1.0) == WELL
    assert inputs.hear(2.0, ('imu', 'odometry'))[0].alarming
    inputs.monitor.reset()
    inputs.monitor.start(0)
    assert inputs.hear(0.1, ('imu', 'odometry')) == []
    assert inputs.hear(1.0, ('imu', 'odometry')) == []
    findings = inputs.monitor.findings(SECOND)
    assert [(finding.subject, finding.unheard) for finding in findings] == [('camera front', False)]


def test_an_image_with_a_future_stamp_counts_as_heard() -> None:
    inputs = MonitoredInputs()
    inputs.monitor.heard('front', 6 * SECOND, SECOND)
    assert not any(finding.unheard for finding in inputs.monitor.findings(SECOND))
