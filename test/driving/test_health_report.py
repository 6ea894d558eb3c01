from raw2drive_ros.driving.health_report import HealthReport, Line
from raw2drive_ros.driving.sensor_monitor import SensorMonitor

SECOND = 1_000_000_000
INPUTS = ('front', 'imu', 'odometry')
WELL = [Line(False, 'nominal: all sensors are well')]


class Told:
    """A monitor and what a log says of it."""

    def __init__(self) -> None:
        self.monitor, self.report = SensorMonitor(('front',)), HealthReport()
        self.monitor.start(0)

    def hear(self, time_s: float, names: tuple[str, ...] = INPUTS) -> list[Line]:
        now_ns = round(time_s * SECOND)
        for name in names:
            self.monitor.heard(name, now_ns, now_ns)
        return self.report.lines(self.monitor.findings(now_ns), self.monitor.complete)


def test_a_log_tells_waiting_from_breaking_and_says_when_all_is_well() -> None:
    told = Told()
    assert told.hear(0.1, ()) == []
    assert told.hear(1.0, ()) == [Line(False, 'waiting for camera front, imu, odometry: nothing heard yet')]
    assert told.hear(2.0, ()) == [], 'once is enough'
    assert told.hear(3.0) == WELL
    assert told.hear(3.1) == []
    (line,) = told.hear(4.0, ('front', 'odometry'))
    assert line.alarming
    assert line.text.startswith('stop: imu: newest is 0.90 s old; ')
    assert told.hear(4.1) == WELL


def test_all_is_well_is_said_also_when_nothing_was_ever_wrong() -> None:
    assert Told().hear(0.1) == WELL


def test_an_input_that_never_came_is_broken_as_soon_as_others_flow() -> None:
    (line,) = Told().hear(1.0, ('front', 'odometry'))
    assert line.alarming
    assert line.text.startswith('stop: imu: silent for 1.00 s; ')


def test_a_jump_of_time_neither_heals_a_dead_camera_nor_makes_it_one_that_was_never_there() -> None:
    told = Told()
    assert told.hear(1.0) == WELL
    assert told.hear(2.0, ('imu', 'odometry'))[0].alarming
    told.monitor.reset()
    told.monitor.start(0)
    assert told.hear(0.1, ('imu', 'odometry')) == []
    assert told.hear(1.0, ('imu', 'odometry')) == []
    findings = told.monitor.findings(SECOND)
    assert [(finding.subject, finding.unheard) for finding in findings] == [('camera front', False)]


def test_a_camera_of_the_future_has_been_heard() -> None:
    told = Told()
    told.monitor.heard('front', 6 * SECOND, SECOND)
    assert not any(finding.unheard for finding in told.monitor.findings(SECOND))
