"""The recorder as a process: snapshots on a stop of the gate and on request, and a simulation that starts again."""

import json
import subprocess
import sys
import time
from pathlib import Path

from mcap.reader import make_reader

from msg_adapters.commands import decision_from_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.evaluation.verify import verify_bag
from raw2drive_ros.graph.drive import GraphJob, drive_graph
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.events import events_of
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.simulation.route_id import RouteId

ROOT = Path(__file__).resolve().parents[2]
# Three seconds of odometry and of invalid proposals, then ~/save.
PROBE = """
import time
import rclpy
from std_srvs.srv import Trigger
from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, OdometrySample
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, factory = rclpy.create_node('probe'), RclpyFactory()
outputs = {name: make_publisher(node, name) for name in (topics.ODOMETRY, topics.PROPOSED)}
client = node.create_client(Trigger, '/recorder/save')
assert client.wait_for_service(30.0)
# The gate may hear a proposal, and stop, before the recorder has discovered the topic.
deadline = time.monotonic() + 30.0
while min(output.get_subscription_count() for output in outputs.values()) < 2:
    assert time.monotonic() < deadline, 'gate and recorder have not discovered the probe'
    rclpy.spin_once(node, timeout_sec=0.05)
deadline = time.monotonic() + 3.0
while time.monotonic() < deadline:
    now_ns = node.get_clock().now().nanoseconds
    outputs[topics.ODOMETRY].publish(odometry_to_message(factory, OdometrySample(now_ns, 0, 0, 0, 0, 0)))
    outputs[topics.PROPOSED].publish(decision_to_message(factory, Decision(now_ns, Control(float('nan')))))
    rclpy.spin_once(node, timeout_sec=0.05)
future = client.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=10)
print(future.result().success, future.result().message)
"""


def test_snapshots_are_written_on_a_stop_of_the_gate_and_on_request(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('recorder', {'bag': str(tmp_path / 'shots'), 'snapshot_s': 2.0}, sim_time=False)
        graph.start('safety_gate', {'clock': 'steady'}, sim_time=False)
        probe = subprocess.run(
            [sys.executable, '-c', PROBE], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=90
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        graph.check()
    assert probe.stdout.split() == ['True', str(tmp_path / 'shots' / 'snapshot_001')]
    first, second = (bag_info(tmp_path / 'shots' / f'snapshot_{number:03d}') for number in range(2))
    assert first['provenance']['snapshot'].startswith('gate: emergency_stop: invalid proposal')
    assert second['provenance']['snapshot'] == '~/save'
    assert second['duration_s'] <= 2.1
    for info in (first, second):
        assert {topics.ODOMETRY, topics.PROPOSED, topics.COMMAND} <= {row['topic'] for row in info['topics']}


def _wait(done, seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_recorder_beside_a_simulation_that_starts_again_writes_a_bag_of_each_drive(tmp_path) -> None:
    progress = tmp_path / 'progress.jsonl'
    bridge = {'lock_step': False, 'image_height': 24, 'image_width': 40, 'progress_file': str(progress)}
    began_ns = time.time_ns()
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {'clock': 'steady', 'simulated': True}, sim_time=False)
        sensors = {'episodes': 'LaneFollowing/0', 'max_ticks': 120, 'wait_for_sensor_subscribers': 0}
        graph.start('bridge', bridge | sensors, sim_time=False)
        # The car drives already: as on a vehicle, sensors do not wait for a recorder.
        _wait(progress.exists)
        recorder = {'bag': str(tmp_path / 'bag'), 'stats_file': str(tmp_path / 'recorder.json')}
        graph.start('recorder', recorder, sim_time=False, end_within_s=60.0)
        _wait(lambda: graph.ended('bridge'))
        sensors = {'episodes': 'LaneFollowing/1', 'max_ticks': 40, 'wait_for_sensor_subscribers': 1}
        graph.start('bridge', bridge | sensors, sim_time=False)
        _wait(lambda: graph.ended('bridge'))
        graph.check(may_end=('bridge',))
        graph.end(order=('recorder',))
    ended_ns = time.time_ns()
    report = json.loads((tmp_path / 'recorder.json').read_text())
    first, second = (Path(bag) for bag in report['bags'])
    assert (first, second) == (tmp_path / 'bag', tmp_path / 'bag' / 'bag_001')
    assert len(report['time_went_back']) == 1
    log = (tmp_path / 'recorder.log').read_text()
    assert 'the recording begins in the middle of LaneFollowing/0' in log
    assert f'another drive begins, which goes to {second}' in log
    assert [e for e in events_of(second) if e.node == 'recorder' and 'time went back by' in e.text]
    begins = [bag_info(bag)['provenance']['begins'] for bag in (first, second)]
    assert begins == ['in the middle of LaneFollowing/0', 'with the first tick of LaneFollowing/1']
    for bag, episode in ((first, 'LaneFollowing/0'), (second, 'LaneFollowing/1')):
        with open_bag(bag) as reader:
            ticks = list(read_ticks(reader, bag, cameras=True))
        assert {tick.episode for tick in ticks} == {episode}
        assert ticks[0].transition.is_first == (bag == second)
        with next(bag.glob('*.mcap')).open('rb') as stream:
            times = [(c.topic, m.log_time, m.publish_time) for _, c, m in make_reader(stream).iter_messages()]
        assert all(began_ns < received_ns < ended_ns for _, received_ns, _ in times)
        assert {stamp_ns for topic, _, stamp_ns in times if topic == topics.EGO} >= {t.stamp_ns for t in ticks}


def test_a_live_bag_of_a_vehicle_in_real_time_verifies(bundle, tmp_path) -> None:
    job = GraphJob(tmp_path, (RouteId('LaneFollowing', 4),), bundle, real_time=True, max_ticks=60)
    with reserve_domain(None) as domain:
        drive_graph(job, domain)
    found = verify_bag(tmp_path / 'bag', bundle)
    assert found.equal, found.text
    assert found.compared > 20
    assert (found.lost, found.not_compared) == (0, 0), found.text
    numbers = []
    with open_bag(tmp_path / 'bag') as reader:
        connections = [c for c in reader.connections if c.topic == topics.PROPOSED]
        for connection, _, data in reader.messages(connections=connections):
            numbers.append(decision_from_message(RosbagsFactory().deserialize(data, connection.msgtype)).sequence)
    assert numbers == list(range(1, len(numbers) + 1)), 'every proposal is there, and numbered'
