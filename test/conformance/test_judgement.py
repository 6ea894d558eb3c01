"""Each way to violate the vehicle's contract gets a verdict with a remedy."""

import numpy as np
import pytest

from msg_adapters.sensors import BASE_FRAME, IMU_FRAME, MAP_FRAME, optical_frame
from raw2drive_ros.conformance.active import CHECKS, judge_trials
from raw2drive_ros.conformance.observation import Observation, TopicSeen, Trial
from raw2drive_ros.conformance.passive import expected, judge
from raw2drive_ros.conformance.programme import FOREIGN, PROGRAMME
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import CameraCalibration, Control, ImuSample, OdometrySample, Route
from raw2drive_ros.simulation.camera_rig import camera_rig

RIG = camera_rig(96, 160)[:2]
CAMERAS = tuple(camera.name for camera in RIG)
FRONT = topics.image_topic('front')
FRAMES = {topics.IMU: IMU_FRAME, topics.ODOMETRY: MAP_FRAME, topics.ROUTE: MAP_FRAME}


def good() -> Observation:
    """A vehicle that does everything right while it stands."""
    seen = Observation(2.0, command_subscribers=1)
    for name in expected(CAMERAS, compressed=False):
        spec = topics.BY_NAME[name]
        period = round(1e9 / spec.rate_hz) if spec.rate_hz else 0
        stamps = [i * period for i in range(20)] if period and not spec.qos.latched else [0]
        frame = FRAMES.get(name) or (BASE_FRAME if 'extrinsics' in name else optical_frame(name.split('/')[3]))
        seen.topics[name] = TopicSeen(
            (spec.msgtype,),
            1,
            transient_local=spec.qos.latched,
            stamps_ns=stamps,
            ages_s=[0.02] * len(stamps),
            frames={frame},
        )
    rng = np.random.default_rng(0)
    for camera in RIG:
        seen.calibrations[camera.name] = camera
        seen.images[camera.name] = rng.integers(0, 255, (camera.height, camera.width, 3), np.uint8)
    seen.imu = [ImuSample(0, (0.0, 0.0, 9.81), (0.0, 0.0, 0.0))] * 5
    seen.odometry = [OdometrySample(0, 1.0, 2.0, 0.0, 0.0, 0.0)] * 5
    seen.route = Route(0, np.array([[0.0, 0.0], [30.0, 0.0]]))
    return seen


def wrong(seen: Observation) -> dict[str, str]:
    found = [v for v in judge(seen, RIG) if v.severity in ('error', 'warning')]
    assert all(v.remedy for v in found)
    return {v.check: v.text for v in found}


def test_a_good_vehicle_passes_everything() -> None:
    verdicts = judge(good(), RIG)
    assert {v.severity for v in verdicts} == {'passed'}
    assert not any(v.remedy for v in verdicts)


def changed(**fields):
    def change(seen: Observation) -> None:
        for name, value in fields.items():
            setattr(seen.topics[FRONT], name, value)

    return change


def standing_imu(force, rate=(0.0, 0.0, 0.0)):
    def change(seen: Observation) -> None:
        seen.imu = [ImuSample(0, force, rate)] * 5

    return change


def all_ages(age_s: float):
    def change(seen: Observation) -> None:
        for topic in seen.topics.values():
            topic.ages_s = [age_s] * len(topic.ages_s)

    return change


def faster_imu(seen: Observation) -> None:
    topic = seen.topics[topics.IMU]
    topic.stamps_ns, topic.ages_s = [i * 10_000_000 for i in range(200)], [0.02] * 200


def between_pictures(seen: Observation) -> None:
    seen.topics[topics.ODOMETRY].stamps_ns = [i * 50_000_000 + 20_000_000 for i in range(-1, 40)]


def turned(seen: Observation) -> None:
    camera, pose = RIG[0], RIG[0].base_from_camera.copy()
    pose[0, 3] += 0.1
    seen.calibrations['front'] = CameraCalibration('front', camera.width, camera.height, camera.intrinsics, pose)


def resized(seen: Observation) -> None:
    camera = RIG[0]
    seen.calibrations['front'] = CameraCalibration('front', 80, 48, camera.intrinsics, camera.base_from_camera)
    seen.images['front'] = np.zeros((48, 80, 3), np.uint8)


@pytest.mark.parametrize(
    ('change', 'check', 'text'),
    [
        (changed(publishers=0), f'{FRONT}: publisher', 'nobody publishes it'),
        (changed(publishers=2), f'{FRONT}: publisher', '2 publishers'),
        (changed(msgtypes=('x/msg/Y',)), f'{FRONT}: publisher', 'it is x/msg/Y'),
        (changed(reliable=False), f'{FRONT}: QoS', 'best effort'),
        (changed(refused=['no size']), f'{FRONT}: content', '1 messages break the contract: no size'),
        (changed(stamps_ns=[0]), f'{FRONT}: rate', '1 messages in 2 s'),
        (changed(stamps_ns=[i * 200_000_000 for i in range(20)]), f'{FRONT}: rate', '5.0 Hz'),
        (changed(stamps_ns=[0, 0, *range(10**8, 19 * 10**8, 10**8)]), f'{FRONT}: stamps', '1 of 20'),
        (changed(stamps_ns=[i * 50_000_000 for i in range(20)]), f'{FRONT}: rate', '20.0 Hz, 2 times 10 Hz'),
        (changed(stamps_ns=[i * 66_666_667 for i in range(20)]), f'{FRONT}: rate', '15.0 Hz'),
        (changed(ages_s=[1.5] * 20), f'{FRONT}: age', '1500 ms at arrival: too old'),
        (changed(ages_s=[-1.5] * 20), f'{FRONT}: age', '-1500 ms at arrival: in the future'),
        (all_ages(1.5), 'clock: stamps', '1500 ms at arrival, 6 of 6 topics: too old'),
        (all_ages(-1.5), 'clock: stamps', '-1500 ms at arrival, 6 of 6 topics: in the future'),
        (lambda s: s.distortion.update(front=(-0.3, 0.1)), 'camera front: calibration', 'distortion, D = -0.3, 0.1'),
        (faster_imu, f'{topics.IMU}: rate', '100.0 Hz'),
        (between_pictures, f'{topics.ODOMETRY}: at the pictures', '0 %'),
        (lambda s: setattr(s, 'wants_sim_time', True), 'clock: source', 'nobody publishes /clock'),
        (changed(stamps_ns=[5 + i * 10**8 for i in range(20)]), 'cameras: one stamp for all', '0 %'),
        (changed(frames={'lens'}), f'{FRONT}: frame', 'frame_id lens'),
        (lambda s: s.topics[topics.ROUTE].__setattr__('transient_local', False), f'{topics.ROUTE}: QoS', 'volatile'),
        (lambda s: s.calibrations.pop('front'), 'camera front: calibration', 'not known'),
        (turned, 'camera front: calibration', 'position 0.100 m'),
        (resized, 'camera front: calibration', '48x80, the bundle needs 96x160'),
        (resized, 'camera front: picture', '48x80'),
        (lambda s: s.images['front'].fill(7), 'camera front: picture', 'without contrast'),
        (standing_imu((0.0, 0.0, 1.0)), 'imu: units', '1.00 m/s2'),
        (standing_imu((0.0, 0.0, 0.0)), 'imu: units', '0.00 m/s2'),
        (standing_imu((0.0, 0.0, 32.2)), 'imu: units', '32.20 m/s2'),
        (standing_imu((0.0, 9.81, 0.0)), 'imu: axes', '9.81'),
        (standing_imu((0.0, 0.0, 9.81), (0.0, 0.0, 2.0)), 'imu: at rest', '2.000 rad/s'),
        (lambda s: setattr(s, 'route', Route(0, np.full((2, 2), 500.0))), 'route: near the car', '705 m'),
        (lambda s: setattr(s, 'command_subscribers', 0), '/control/command: subscriber', '0'),
    ],
)
def test_what_breaks_the_contract_is_named(change, check, text) -> None:
    seen = good()
    change(seen)
    found = wrong(seen)
    assert check in found
    assert text in found[check]


def test_one_cause_is_one_finding() -> None:
    """An IMU without gravity has no axes to be wrong, and late stamps of everything are one clock."""
    for change, check in (
        (standing_imu((0.0, 0.0, 0.0)), 'imu: units'),
        (all_ages(1.5), 'clock: stamps'),
        (lambda s: s.distortion.update(front=(-0.3,)), 'camera front: calibration'),
    ):
        seen = good()
        change(seen)
        assert list(wrong(seen)) == [check]


def test_rates_that_the_planner_can_take_are_warnings_and_others_errors() -> None:
    def severity(name: str, hz: float) -> str:
        seen = good()
        seen.topics[name].stamps_ns = [round(i * 1e9 / hz) for i in range(60)]
        return next(v.severity for v in judge(seen, RIG) if v.check == f'{name}: rate')

    assert [severity(FRONT, hz) for hz in (9.5, 10.5, 20.0, 30.0)] == ['passed', 'passed', 'warning', 'warning']
    assert [severity(FRONT, hz) for hz in (5.0, 8.0, 15.0, 25.0, 33.0)] == ['error'] * 5
    assert [severity(topics.IMU, hz) for hz in (15.0, 20.0, 50.0, 100.0)] == ['error', 'passed', 'warning', 'warning']


def test_simulated_time_is_told() -> None:
    seen = good()
    seen.sim_time = seen.wants_sim_time = True
    found = {v.check: v.severity for v in judge(seen, RIG)}
    assert found['clock: source'] == 'passed'


def test_an_empty_observation_gives_errors_and_no_crash() -> None:
    assert len(wrong(Observation(2.0))) > 8


def trial(name: str, speeds, yaw_rates=None) -> Trial:
    times = [0.1 * i for i in range(len(speeds))]
    return Trial(name, Control(), times, list(speeds), list(yaw_rates or np.zeros(len(speeds))))


GOING, STOPPING = np.linspace(0, 3, 25), np.linspace(4, 0, 25)


@pytest.mark.parametrize(
    ('name', 'right', 'false'),
    [
        ('brake holds', trial('', np.zeros(10)), trial('', GOING)),
        ('throttle drives forward', trial('', GOING), trial('', -GOING)),
        ('steer left', trial('', GOING, [0.2] * 25), trial('', GOING, [-0.2] * 25)),
        ('steer right', trial('', GOING, [-0.2] * 25), trial('', GOING, [0.2] * 25)),
        ('brake stops', trial('', STOPPING), trial('', GOING)),
        ('silence stops', trial('', STOPPING), trial('', np.full(25, 4.0))),
        ('NaN is refused', trial('', STOPPING), trial('', np.full(25, 4.0))),
        ('absurd values are refused', trial('', STOPPING), trial('', GOING + 4)),
        (FOREIGN, trial('', np.zeros(25)), trial('', GOING)),
    ],
)
def test_each_trial_has_a_right_and_a_wrong_answer(name, right, false) -> None:
    right.name = false.name = name
    (good_verdict,), (bad_verdict,) = judge_trials([right]), judge_trials([false])
    assert (good_verdict.severity, good_verdict.remedy) == ('passed', '')
    assert bad_verdict.severity == 'error'
    assert bad_verdict.remedy


def test_a_car_that_only_coasts_does_not_brake_by_itself() -> None:
    braking, coasting = trial('brake stops', STOPPING), trial('silence stops', np.linspace(3.0, 0.0, 50))
    asked, by_itself = judge_trials([braking, coasting])
    assert (asked.severity, by_itself.severity) == ('passed', 'error')
    assert by_itself.text.endswith('braking at 0.6 m/s2')
    assert judge_trials([braking, trial('NaN is refused', STOPPING)])[1].severity == 'passed'
    at_once = trial('NaN is refused', [1.2, 0.9, 0.5, 0.1, 0.0, 0.0, 0.0])
    assert judge_trials([braking, at_once])[1].severity == 'passed'
    assert judge_trials([braking, trial('NaN is refused', np.zeros(20))])[1].severity == 'error', 'it never rolled'


def test_every_named_step_is_judged_and_the_car_is_stopped_at_the_end() -> None:
    assert {step.name for step in PROGRAMME if step.name} == set(CHECKS)
    assert PROGRAMME[-1].control.brake > 0.0
    assert judge_trials([trial('steer left', [])])[0].text == 'no odometry during the trial'


def test_of_two_trials_with_one_name_the_failed_one_counts() -> None:
    obeys, refuses = trial(FOREIGN, GOING), trial(FOREIGN, np.zeros(25))
    for pair in ([obeys, refuses], [refuses, obeys]):
        assert [v.severity for v in judge_trials(pair)] == ['error']
    assert [v.severity for v in judge_trials([refuses, refuses])] == ['passed']
