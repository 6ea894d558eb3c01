"""Two whole stacks in one ROS domain, in a namespace each: each car is driven by its own, and one may end."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.graph.processes import Graph, reserve_domain, running_graph
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.events import events_of
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

ROOT = Path(__file__).resolve().parents[2]
ROUTES = {'/car1': RouteId('LaneFollowing', 4), '/car2': RouteId('LaneFollowing', 1)}
TICKS = 30


def start_stack(graph: Graph, bundle: Path, *, loop: bool) -> None:
    out = graph.folder
    listeners = 1
    if not loop:
        graph.start('recorder', {'bag': str(out / 'bag')})
        listeners += 1
    graph.start('safety_gate', {'clock': 'ros', 'simulated': True})
    graph.start('planner', {'bundle': str(bundle)})
    bridge = {
        'episodes': str(ROUTES[graph.namespace]),
        'loop': loop,
        'max_ticks': TICKS,
        'wait_for_sensor_subscribers': listeners,
        'rows_file': str(out / 'rows.jsonl'),
    }
    graph.start('bridge', bridge, sim_time=False)


def rows_of(graph: Graph) -> list[dict]:
    file = graph.folder / 'rows.jsonl'
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def wait_until(condition, graphs: tuple[Graph, ...]) -> None:
    deadline = time.monotonic() + 240.0
    while not condition():
        assert time.monotonic() < deadline
        for graph in graphs:
            graph.check(may_end=('bridge',))
        time.sleep(0.2)


def test_each_stack_drives_its_own_car_and_may_end_alone(bundle, tmp_path, capsys) -> None:
    with (
        reserve_domain(None) as domain,
        running_graph(tmp_path / '1', domain, '/car1') as first,
        running_graph(tmp_path / '2', domain, '/car2') as second,
    ):
        start_stack(first, bundle, loop=False)
        start_stack(second, bundle, loop=True)
        wait_until(lambda: first.ended('bridge'), (first, second))
        first.end(order=('recorder',))
        driven = len(rows_of(second))
        wait_until(lambda: len(rows_of(second)) > driven + 1, (second,))
        capsys.readouterr()
        assert main(['call', '--namespace', 'car2', '--domain', str(domain), '/bridge/pause', 'true']) == 0
        assert capsys.readouterr().out.strip() == 'paused'
    driver, env = make_driver('raw', bundle), DrivingEnv(SimulationConfig(end_on_infraction=False))
    for graph in (first, second):
        expected = drive_route(env, driver, ROUTES[graph.namespace], max_ticks=TICKS).result.to_json()
        rows = rows_of(graph)
        assert rows and all(row == expected for row in rows), graph.namespace
    bag = first.folder / 'bag'
    assert set(topics.BY_NAME) >= {row['topic'] for row in bag_info(bag)['topics']}
    assert {event.node for event in events_of(bag)} == {'bridge', *(f'/car1/{node}' for node in first.processes)}


@pytest.mark.parametrize('name', ['car-1', '/car 1', '1car', 'a__b', '/a//b'])
def test_a_name_that_is_no_namespace_is_wrong_usage(name, capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['sim', '--namespace', name])
    assert ended.value.code == 2
    assert 'a namespace is as /car1' in capsys.readouterr().err


def test_the_options_reach_the_nodes(tmp_path) -> None:
    """A namespace without its slash; what the verb prints for other nodes carries it too."""
    with reserve_domain(None) as domain:
        command = [
            sys.executable,
            '-m',
            'raw2drive_ros.cli.main',
            'faults',
            'run',
            'camera lost',
            '--namespace',
            'car1',
        ]
        child = subprocess.Popen(
            [*command, '--domain', str(domain)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            assert f'running in ROS domain {domain} as /car1' in child.stderr.readline()
        finally:
            child.terminate()
            printed = child.communicate(timeout=30)[0]
    topic = topics.image_topic('front')
    assert f'--ros-args -r /car1{topic}:=/car1/faulty{topic}' in printed
