"""The player: pause, step, seek, rate and loop, as seen on /clock."""

import itertools
import json
import subprocess
import sys
from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import OdometrySample
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.recording.bag_reader import begin_ns, open_bag

PROBE = Path(__file__).with_name('player_probe.py')
ROOT = PROBE.parents[2]


def test_a_player_pauses_steps_seeks_and_loops(bag, tmp_path) -> None:
    with open_bag(bag) as reader:
        start_ns, end_ns = begin_ns(reader), reader.end_time
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        parameters = {'bag': str(bag), 'paused': True, 'loop': True, 'wait_for_subscribers': 0}
        graph.start('player', parameters, sim_time=False)
        probe = subprocess.run(
            [sys.executable, str(PROBE)], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        graph.check()
    observed = json.loads(probe.stdout.splitlines()[-1])
    assert observed['step while paused'] is True
    assert len(observed['one step']) == 1
    assert observed['nothing'] == observed['paused'] == []
    assert (observed['wrong rate'], observed['rate'], observed['start']) == (False, True, True)
    playing = observed['playing']
    assert playing == sorted(playing)
    assert 1.4e9 < playing[-1] - playing[0] < 2.3e9, 'twice as fast as recorded'
    assert observed['after seek'] == [start_ns + 500_000_000]
    assert observed['step while playing'] is False
    again = observed['again']
    assert max(again) <= end_ns
    back = [b for a, b in itertools.pairwise(again) if b < a]
    assert back[0] == start_ns + 500_000_000, 'a loop starts again at start_s'


# Lets a paused player go and prints the stamps of /clock and of the odometry, in order, until it has ended.
LISTENER = """
import json, time
import rclpy
from std_srvs.srv import SetBool
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import LossCounter, make_subscription
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, losses, heard = rclpy.create_node('listener'), LossCounter(), {'clock': [], 'odometry': [], 'imu': []}
def hear(name, topic, stamp_of):
    make_subscription(node, topic, lambda message: heard[name].append(stamp_ns(stamp_of(message))), losses, depth=1000)
hear('clock', topics.CLOCK, lambda message: message.clock)
hear('odometry', topics.ODOMETRY, lambda message: message.header.stamp)
hear('imu', topics.IMU, lambda message: message.header.stamp)
client = node.create_client(SetBool, '/player/pause')
assert client.wait_for_service(30.0)
deadline = time.monotonic() + 30.0
while node.count_publishers(topics.ODOMETRY) < 1 and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.05)
end = time.monotonic() + 1.0
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.05)
client.call_async(SetBool.Request(data=False))
while time.monotonic() < deadline and (len(heard['odometry']) < 2 or node.count_publishers(topics.ODOMETRY)):
    rclpy.spin_once(node, timeout_sec=0.05)
print(json.dumps(heard))
"""


def test_a_player_plays_the_drives_of_another_recorders_bag_by_their_stamps(tmp_path) -> None:
    # Its log time is that of the wall, time goes back in between, and the IMU's topic carries another type.
    second, wall_ns = 1_000_000_000, 1_790_000_000_000_000_000
    stamps = [
        [second + tick * second // 20 for tick in range(40)],
        [second + tick * second // 20 for tick in range(20)],
    ]
    factory = RosbagsFactory()
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        odometry = writer.add_connection(topics.ODOMETRY, 'nav_msgs/msg/Odometry', typestore=factory.typestore)
        wrong = writer.add_connection(topics.IMU, 'nav_msgs/msg/Odometry', typestore=factory.typestore)
        for count, stamp_ns in enumerate(itertools.chain(*stamps)):
            message = odometry_to_message(factory, OdometrySample(stamp_ns, float(count), 0.0, 0.0, 0.0, 0.0))
            for connection in (odometry, wrong):
                writer.write(connection, wall_ns + count, factory.serialize(message, 'nav_msgs/msg/Odometry'))
    with reserve_domain(None) as domain, running_graph(tmp_path / 'logs', domain) as graph:
        parameters = {'bag': str(tmp_path / 'bag'), 'paused': True, 'wait_for_subscribers': 0}
        graph.start('player', parameters, sim_time=False)
        listener = subprocess.run(
            [sys.executable, '-c', LISTENER],
            cwd=ROOT,
            env=graph.environment,
            capture_output=True,
            text=True,
            timeout=90,
        )
        assert listener.returncode == 0, listener.stderr[-2000:]
        graph.check(may_end=('player',))
        log = (tmp_path / 'logs' / 'player.log').read_text()
    heard = json.loads(listener.stdout.splitlines()[-1])
    assert heard['odometry'][-40:] == [*stamps[0], *stamps[1]][-40:]
    assert set(heard['clock']) <= {*stamps[0], *stamps[1]}, 'the clock is that of the stamps'
    assert [b for a, b in itertools.pairwise(heard['clock']) if b < a] == [second], 'and goes back once'
    assert heard['imu'] == []
    assert 'time goes back in this bag: 2 drives' in log
    assert f'{topics.IMU} is nav_msgs/msg/Odometry, not sensor_msgs/msg/Imu: not played' in log
