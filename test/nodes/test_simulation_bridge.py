"""The bridge starts when every sensor topic has its subscribers, and publishes what the topic table says."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.nodes.transport import child_environment

PROBE = Path(__file__).with_name('subscriber_probe.py')
ROOT = PROBE.parents[2]
QUICK = {'lock_step': False, 'bev': False, 'image_height': 24, 'image_width': 40, 'episodes': 'LaneFollowing/0'}
IMAGES = [topics.image_topic(camera) for camera in topics.CAMERAS]
UNUSED = {topics.IMU_EXTRINSICS, *map(topics.compressed_topic, topics.CAMERAS)}
OTHERS = [name for name in topics.SENSOR_TOPICS if name not in {*IMAGES, *UNUSED}]
SENSORS = [*IMAGES, *OTHERS]


@pytest.mark.parametrize(
    ('parameters', 'steps'),
    [
        (
            {'wait_for_sensor_subscribers': 1},
            {
                'images alone': [['planner', name] for name in IMAGES],
                'all but odometry, which the gate hears': [
                    *(['planner', name] for name in OTHERS if name != topics.ODOMETRY),
                    ['safety_gate', topics.ODOMETRY],
                ],
                'everything': [['planner', topics.ODOMETRY]],
            },
        ),
        (
            {'wait_for_sensor_subscribers': 2},
            {
                'a planner': [['planner', name] for name in SENSORS],
                'a recorder that has not found the IMU': [['recorder', n] for n in SENSORS if n != topics.IMU],
                'everything': [['recorder', topics.IMU]],
            },
        ),
        (
            {'wait_for_sensor_subscribers': 2, 'sim_driver': 'rule'},
            {
                'a recorder of proposals': [['recorder', topics.PROPOSED]],
                'and a gate': [['safety_gate', name] for name in (topics.PROPOSED, topics.ODOMETRY)],
                'everything': [['recorder', name] for name in SENSORS],
            },
        ),
    ],
    ids=['planner', 'planner and recorder', 'sim driver and recorder'],
)
def test_it_waits_until_every_sensor_topic_has_its_subscribers(tmp_path, parameters, steps) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('bridge', QUICK | parameters, sim_time=False)
        probe = subprocess.run(
            [sys.executable, str(PROBE), json.dumps(list(steps.values()))],
            cwd=ROOT,
            env=graph.environment,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert probe.returncode == 0, (probe.stderr[-2000:], (tmp_path / 'bridge.log').read_text())
    driven = dict(zip(steps, json.loads(probe.stdout.splitlines()[-1]), strict=True))
    assert driven == {name: name == list(steps)[-1] for name in steps}


def test_the_former_name_of_the_parameter_is_an_error_that_names_the_new_one(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('bridge', {'wait_for_image_subscribers': 1}, sim_time=False)
        assert graph.processes['bridge'].wait(60) == 1
        said = graph.last_words('bridge')
    assert said.startswith('no such parameter: wait_for_image_subscribers; bridge knows ')
    assert 'wait_for_sensor_subscribers' in said


# Prints the topics of both bridges, made from a table whose prose (`carries` and the words for publishers) is replaced.
# The CARLA bridge makes its publishers before it calls its server, for which nothing is needed here.
BRIDGES = """
import ast, importlib.util, json, sys, types
import rclpy

class Rewrite(ast.NodeTransformer):
    def visit_keyword(self, node):
        return ast.keyword('carries', ast.Constant('something')) if node.arg == 'carries' else node
    def visit_ClassDef(self, node):
        if node.name == 'Publisher':
            for member in node.body:
                if isinstance(member, ast.Assign):
                    member.value = ast.Constant(f'somebody like {member.targets[0].id}')
        return self.generic_visit(node)

spec = importlib.util.find_spec('raw2drive_ros.contracts.topics')
table = types.ModuleType('raw2drive_ros.contracts.topics')
sys.modules[table.__name__] = table
tree = ast.fix_missing_locations(Rewrite().visit(ast.parse(open(spec.origin).read())))
exec(compile(tree, spec.origin, 'exec'), table.__dict__)
import raw2drive_ros
raw2drive_ros.contracts.topics = table
assert {row.carries for row in table.TOPICS} == {'something'} and 'somebody like VEHICLE' in table.markdown_table()

from raw2drive_ros.nodes import bridge, carla_bridge
from raw2drive_ros.nodes.transport import configure_transport

assert bridge.topics is carla_bridge.topics is table
carla_bridge.CarlaVehicle = lambda settings, rig: types.SimpleNamespace(versions=('0', '0'))
configure_transport()
rclpy.init()
print(json.dumps([list(bridge.BridgeNode().outputs), list(carla_bridge.CarlaBridgeNode().outputs)]))
"""


def test_the_bridges_publish_exactly_these_topics_whatever_the_prose_of_the_table_says() -> None:
    cameras = [
        f'/sensing/camera/{camera}/{name}'
        for camera in ('front', 'front_left', 'front_right', 'back', 'back_left', 'back_right')
        for name in ('image_raw', 'image_raw/compressed', 'camera_info', 'extrinsics')
    ]
    motion = ['/sensing/imu', '/sensing/imu/extrinsics', '/vehicle/odometry', '/planning/route']
    privileged = [f'/privileged/{name}' for name in ('bev', 'bev_visible', 'ego', 'signals', 'actors', 'transition')]
    with reserve_domain(None) as domain:
        child = subprocess.run(
            [sys.executable, '-c', BRIDGES],
            cwd=ROOT,
            env=child_environment(domain),
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert child.returncode == 0, child.stderr[-2000:]
    simulation, carla = json.loads(child.stdout.splitlines()[-1])
    assert simulation == ['/clock', *cameras, *motion, *privileged]
    assert carla == ['/clock', *cameras, *motion]
