"""The real graph: separate processes, DDS, MCAP. Small drives with the nano policy."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import DomainBusyError, GraphError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
from raw2drive_ros.evaluation.verify import recorded_proposals, verify_bag
from raw2drive_ros.graph.drive import GraphJob, drive_graph, evaluate_graph
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.events import events_of
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

ROUTES = (RouteId('LaneFollowing', 4), RouteId('VanillaSignalizedTurnEncounterRedLight', 1, 'HardRainNight'))
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope='module')
def driven(bundle, tmp_path_factory):
    """Two short routes through the graph in lock-step."""
    out = tmp_path_factory.mktemp('graph')
    with reserve_domain(None) as domain:
        return out, *drive_graph(GraphJob(out, ROUTES, bundle), domain)


def test_graph_and_in_process_evaluation_give_the_same_commands_bit_for_bit(driven, bundle) -> None:
    out, driven_rows, _ = driven
    proposals = list(recorded_proposals(out / 'bag').values())
    driver = make_driver('raw', bundle)
    env = DrivingEnv(SimulationConfig(end_on_infraction=False))
    expected, rows = [], []
    for route in ROUTES:
        drive = drive_route(env, driver, route)
        # The graph decides on the last frame of an episode too, but that decision is not applied.
        expected.append(drive.controls)
        rows.append(drive.result)
    first = len(expected[0])
    assert proposals[:first] == expected[0]
    assert proposals[first + 1 : first + 1 + len(expected[1])] == expected[1]
    assert driven_rows == rows


def test_rule_driver_as_sim_driver_scores_as_it_does_in_process() -> None:
    routes = [RouteId('HardBreakRoute', 0), RouteId('NonSignalizedJunctionLeftTurn', 1, repetition=1)]
    seen = []
    graph = evaluate_graph(
        DriverSpec('rule'), 'x', '1', routes, Conditions(), None, lambda done, row: seen.append((done, row.id))
    )
    alone = evaluate(DriverSpec('rule'), 'x', '1', routes)
    assert graph['routes'] == alone['routes']
    assert graph['timing']['messages_lost'] == graph['timing']['commands_missed'] == 0
    assert seen == [(1, str(routes[0])), (2, str(routes[1]))]


def test_nothing_is_lost_and_timing_is_reported(driven) -> None:
    _, _, timing = driven
    assert timing['messages_lost'] == 0
    assert timing['commands_missed'] == 0
    assert timing['planner_ms']['p50'] > 0
    assert timing['ticks_per_s'] > 0


def test_the_bag_is_whole_and_replays_to_the_same_decisions(driven, bundle) -> None:
    out, *_ = driven
    info = bag_info(out / 'bag')
    with open_bag(out / 'bag') as reader:
        ticks = [tick.stamp_ns for tick in read_ticks(reader, out / 'bag', cameras=True)]
    assert list(recorded_proposals(out / 'bag')) == ticks
    assert len(set(info['episodes'])) == 2
    verification = verify_bag(out / 'bag', bundle)
    assert verification.equal, verification.text
    assert verification.compared == len(ticks)
    assert (verification.first, verification.differing) == (None, {})
    other = verify_bag(out / 'bag', default_bundle())
    assert not other.equal
    assert other.first['stamp_ns'] in ticks
    assert other.first['field'] in other.differing
    assert f'first /control/proposed at {other.first["stamp_ns"]} ns: {other.first["field"]}' in other.text


def test_compressed_images_drive_are_recorded_and_replay_to_the_same_decisions(bundle, tmp_path) -> None:
    job = GraphJob(tmp_path, ROUTES[:1], bundle, max_ticks=15, image_transport='compressed')
    with reserve_domain(None) as domain:
        _, timing = drive_graph(job, domain)
    assert timing['messages_lost'] == 0
    found = {row['topic'] for row in bag_info(tmp_path / 'bag')['topics']}
    assert topics.compressed_topic('back') in found
    assert topics.image_topic('back') not in found
    verification = verify_bag(tmp_path / 'bag', bundle)
    assert verification.equal, verification.text
    assert verification.compared == 16


@pytest.mark.parametrize(
    ('plan', 'log', 'words'),
    [
        ('camera lost', 'planner', 'stop: camera front: newest is'),
        ('planner nan', 'safety_gate', 'emergency_stop: invalid proposal: named values: not finite'),
    ],
)
def test_a_fault_between_the_real_nodes_stops_the_car_and_is_logged(bundle, tmp_path, plan, log, words) -> None:
    job = GraphJob(tmp_path, ROUTES[:1], bundle, real_time=True, max_ticks=80, faults=('matrix', plan))
    with reserve_domain(None) as domain:
        drive_graph(job, domain)
    logs = {name: (tmp_path / 'logs' / f'{name}.log').read_text() for name in ('planner', 'safety_gate')}
    assert words in logs[log]
    assert '_stop: ' in logs['safety_gate']
    assert 'driving' not in logs['safety_gate'].split('_stop: ')[1], 'a stop is latched'
    # The bag shows the same: the fault, the node that noticed it, and the stop.
    events = events_of(tmp_path / 'bag')
    assert [e for e in events if e.node == 'fault_injector' and e.level == 'warning']
    assert [e for e in events if e.node == log and e.level == 'error' and words.split('_stop: ')[-1] in e.text]
    assert [e for e in events if e.node == 'safety_gate' and e.level == 'error']


def test_a_gate_that_stopped_in_one_episode_drives_in_the_next(tmp_path) -> None:
    # The next episode starts elsewhere: a stop of the previous one must not hold the car.
    plans = tmp_path / 'plans.yaml'
    plans.write_text('plans: {once: [{topic: /control/proposed, kind: nan, start_s: 2, duration_s: 1}]}')
    job = GraphJob(
        tmp_path, ROUTES, sim_driver='rule', real_time=True, max_ticks=60, record=False, faults=(str(plans), 'once')
    )
    with reserve_domain(None) as domain:
        stopped, driven = drive_graph(job, domain)[0]
    log = (tmp_path / 'logs' / 'safety_gate.log').read_text()
    assert log.index('emergency_stop: invalid proposal') < log.index('started over: ')
    assert stopped.route_completion < 5.0 < 20.0 < driven.route_completion


def test_two_graphs_cannot_share_a_domain() -> None:
    with reserve_domain(91), pytest.raises(DomainBusyError, match='choose another with --domain'), reserve_domain(91):
        pass


def test_a_planner_with_the_wrong_camera_size_refuses_and_the_graph_says_so(bundle, tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {'clock': 'ros'})
        graph.start('planner', {'bundle': str(bundle)})
        graph.start(
            'bridge',
            {'episodes': 'LaneFollowing/0', 'image_height': 64, 'image_width': 96, 'max_ticks': 1},
            sim_time=False,
        )
        deadline = time.monotonic() + 40
        while not graph.ended('bridge') and time.monotonic() < deadline:
            time.sleep(0.2)
        log = (tmp_path / 'planner.log').read_text()
    assert 'is 64x96, the bundle needs 96x160' in log


def test_a_missing_bundle_ends_the_planner_with_one_clear_line(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('planner', {'bundle': str(tmp_path / 'nowhere')})
        graph.processes['planner'].wait(30)
        assert graph.processes['planner'].returncode == 1
        with pytest.raises(GraphError, match='no policy bundle there'):
            graph.check()


@pytest.mark.parametrize(('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_demo_quickly_without_orphans_and_with_a_closed_bag(bundle, tmp_path, number, code) -> None:
    out = tmp_path / 'demo'
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'demo', '--bundle', str(bundle), '--out', str(out)]
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stderr=subprocess.PIPE,
        start_new_session=True,
        env=os.environ | {'PYTHONUNBUFFERED': '1'},
        # Shells start background jobs with SIGINT ignored, which children inherit: tests may run in one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    progress = out / 'progress.jsonl'
    deadline = time.monotonic() + 60
    while not progress.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    started = time.monotonic()
    process.send_signal(number)
    process.wait(20)
    assert time.monotonic() - started < 6.0
    assert process.returncode == code
    listing = subprocess.run(['ps', '-eo', 'args'], capture_output=True, text=True, check=True).stdout
    assert str(out) not in listing
    assert bag_info(out / 'bag')['messages'] > 0
    assert json.loads((out / 'recorder.json').read_text())['messages_lost'] == 0
