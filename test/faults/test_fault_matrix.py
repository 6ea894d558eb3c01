"""Every single fault of the shipped matrix ends in a bounded, logged reaction, with the shipped policy driving."""

import re

import pytest

from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.faulty_drive import drive_with_faults
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.faults.plan import load_plans
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.timing import load_timing

ROUTE = RouteId('LaneFollowing', 1)
START_S = 2.0
NOMINAL, COMFORTABLE, EMERGENCY, VEHICLE = '', 'comfortable_stop', 'emergency_stop', 'vehicle'
# plan: (what stops the car first, seconds from the fault to that, what the gate or the planner says)
EXPECTED = {
    'camera lost': (COMFORTABLE, 0.4, 'camera front: newest is'),
    'all cameras lost': (COMFORTABLE, 0.4, 'camera front: newest is'),
    "half of one camera's images lost": (COMFORTABLE, 2.0, 'camera back: newest is|camera sets: '),
    'camera late': (COMFORTABLE, 0.4, 'camera front: newest is'),
    'camera frozen': (COMFORTABLE, 1.0, 'camera front: the same picture'),
    'camera black': (COMFORTABLE, 0.6, 'camera front: black'),
    'camera white': (COMFORTABLE, 0.6, 'camera front: white'),
    'camera of another size': (COMFORTABLE, 0.4, 'front: refused'),
    'camera with old stamps': (COMFORTABLE, 0.4, 'camera front: newest is'),
    'camera with early stamps': (COMFORTABLE, 0.4, 'camera front: stamps are 1.00 s ahead'),
    'images twice': (NOMINAL, 0.0, ''),
    'noisy cameras': (NOMINAL, 0.0, ''),
    'imu lost': (COMFORTABLE, 0.4, 'imu: newest is'),
    'imu nan': (COMFORTABLE, 0.4, 'imu: refused: ImuSample: not finite'),
    'imu absurd': (COMFORTABLE, 0.8, 'imu: specific force'),
    'imu noisy': (NOMINAL, 0.0, ''),
    'odometry lost': (COMFORTABLE, 0.4, 'odometry: newest is'),
    'odometry nan': (COMFORTABLE, 0.4, 'odometry: refused'),
    'odometry late': (COMFORTABLE, 0.4, 'odometry: newest is'),
    'route lost': (NOMINAL, 0.0, ''),
    'everything late': (COMFORTABLE, 0.4, 'newest is'),
    'planner silent': (COMFORTABLE, 0.4, 'no valid proposal for 400 ms'),
    'planner late': (COMFORTABLE, 0.4, 'no valid proposal for 400 ms'),
    'planner nan': (EMERGENCY, 0.0, 'invalid proposal: named values: not finite: throttle'),
    'planner absurd': (EMERGENCY, 0.3, 'invalid proposal: Control.throttle'),
    'planner with old stamps': (COMFORTABLE, 0.4, 'old; do planner and gate have the same clock'),
    'planner swings': (COMFORTABLE, 1.2, 'steering swings to and fro'),
    'planner at full lock': (COMFORTABLE, 5.2, 'full lock for 5 s'),
    'gate silent': (VEHICLE, 0.4, 'the vehicle heard no command'),
    # The vehicle stops at once, and reports that to the gate.
    'gate nan': (EMERGENCY, 0.0, 'was refused: named values: not finite: throttle'),
}
PLANS = load_plans('matrix')


@pytest.fixture(scope='module')
def planner() -> RawPlanner:
    return RawPlanner(load_bundle(default_bundle()), load_monitor_config().limits(load_timing()))


@pytest.fixture(scope='module')
def env() -> DrivingEnv:
    return DrivingEnv(SimulationConfig(bev=False, end_on_infraction=False))


def test_every_plan_has_an_expectation() -> None:
    assert set(PLANS.plans) == set(EXPECTED)


@pytest.mark.parametrize('name', EXPECTED)
def test_a_fault_ends_in_the_stated_reaction(name, planner, env) -> None:
    faults = [fault.model_copy(update={'start_s': START_S}) for fault in PLANS.plans[name]]
    state, within_s, words = EXPECTED[name]
    ticks = round(10 * (START_S + max(within_s, 1.0))) + 2
    states = []
    drive = drive_with_faults(
        env, planner, Injector(faults), ROUTE, lambda tick, gate: states.append(gate.state.value), ticks
    )
    assert drive.counts, 'the fault never touched a message'
    assert 'driving' in states
    if not state:
        assert drive.stop_s is None, (drive.reason, drive.causes)
        return
    assert drive.stop_s is not None
    assert 0.0 <= drive.stop_s - START_S <= within_s + 1e-6, (drive.stop_s, drive.reason)
    first = next((s for s in states if s.endswith('stop')), VEHICLE)
    assert first == state
    assert re.search(words, ' | '.join([drive.reason, *drive.causes])), (drive.reason, drive.causes)
    stopped = drive.controls[round(drive.stop_s * 10) :]
    assert all(control.throttle == 0.0 for control in stopped)
    assert stopped[-1].brake > 0.0


def test_without_faults_it_drives_as_in_the_plain_evaluation(planner, env) -> None:
    faulty = drive_with_faults(env, planner, Injector([]), ROUTE, max_ticks=40)
    plain = drive_route(env, make_driver('raw', default_bundle()), ROUTE, max_ticks=40)
    assert faulty.controls == plain.controls
    assert (faulty.stop_s, faulty.causes, faulty.counts) == (None, [], {})


def test_a_stopped_car_stands_and_the_drive_ends(planner, env) -> None:
    faults = [fault.model_copy(update={'start_s': START_S}) for fault in PLANS.plans['planner silent']]
    drive = drive_with_faults(env, planner, Injector(faults), ROUTE)
    assert drive.stop_s is not None
    assert drive.stand_s is not None
    assert drive.stand_s > drive.stop_s
    assert drive.stop_state == 'emergency_stop', 'silence that lasts is braked hard'
    assert len(drive.controls) < 100
