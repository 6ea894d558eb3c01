"""Everything stays on this machine unless asked: sockets, discovery, and nodes of other packages beside ours."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.nodes import transport

ROOT = Path(__file__).parents[2]
# Talks and listens on one topic until it has heard `others`, then prints them and the addresses of its sockets.
PEER = """
import json, os, sys, time
from pathlib import Path
import rclpy
from std_msgs.msg import String

name, others, ours = sys.argv[1], set(sys.argv[2].split(',')), sys.argv[3] == 'ours'
if ours:
    from raw2drive_ros.nodes.transport import configure_transport
    configure_transport()
rclpy.init()
node, heard = rclpy.create_node(name), set()
node.create_subscription(String, 'talk', lambda message: heard.add(message.data), 10)
publisher = node.create_publisher(String, 'talk', 10)
end = time.monotonic() + 20.0
while time.monotonic() < end and not others <= heard:
    publisher.publish(String(data=name))
    rclpy.spin_once(node, timeout_sec=0.1)
for _ in range(20):  # until the others have heard it too
    publisher.publish(String(data=name))
    time.sleep(0.1)
links = [os.readlink(f'/proc/self/fd/{number}') for number in os.listdir('/proc/self/fd') if number.isdigit()
         and os.path.islink(f'/proc/self/fd/{number}')]
own = {link[8:-1] for link in links if link.startswith('socket:')}
rows = [line.split() for kind in ('udp', 'udp6', 'tcp', 'tcp6')
        for line in Path(f'/proc/net/{kind}').read_text().splitlines()[1:]]
print(json.dumps([sorted(heard), sorted({row[1].split(':')[0] for row in rows if row[9] in own})]))
"""
LOOPBACK = '0100007F'
STRANGER = {transport.PROFILE_VARIABLE, transport.OTHER_PROFILE_VARIABLE, transport.RANGE_VARIABLE}


def environment_of_a_user(domain: int, **variables: str) -> dict[str, str]:
    """As in a new terminal: nothing that this process has set for itself."""
    kept = {name: value for name, value in os.environ.items() if name not in STRANGER}
    return kept | {'ROS_DOMAIN_ID': str(domain), 'PYTHONPATH': str(ROOT)} | variables


def talk(cwd: Path, peers: dict[str, tuple[str, dict[str, str]]]) -> dict[str, list]:
    """Start the peers, name -> (ours or stranger, environment variables): name -> [who it heard, its addresses]."""
    with reserve_domain(None) as domain:
        children = {
            name: subprocess.Popen(
                [sys.executable, '-c', PEER, name, ','.join(peers), kind],
                cwd=cwd,
                env=environment_of_a_user(domain, **variables),
                stdout=subprocess.PIPE,
                text=True,
            )
            for name, (kind, variables) in peers.items()
        }
        return {name: json.loads(child.communicate(timeout=60)[0]) for name, child in children.items()}


def test_ours_find_each_other_and_nodes_of_other_packages_without_a_socket_on_the_network(tmp_path) -> None:
    """Whatever a user's shell says of discovery, and whatever lies in the working directory."""
    open_profile = (ROOT / 'params' / 'fastdds_network.xml').read_text().replace('raw2drive_', 'planted_')
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text(open_profile)
    asked = {'ROS_LOCALHOST_ONLY': '1', transport.RANGE_VARIABLE: 'LOCALHOST'}
    closed = {transport.SKIP_WORKING_DIRECTORY_VARIABLE: '1'}
    found = talk(
        tmp_path,
        {
            'gate': ('ours', {}),
            'planner': ('ours', asked),
            'plain': ('stranger', closed),
            'local': ('stranger', closed | {transport.RANGE_VARIABLE: 'LOCALHOST'}),
        },
    )
    assert all(heard == sorted(found) for heard, _ in found.values())
    assert found['gate'][1] == found['planner'][1] == [LOOPBACK]
    assert '00000000' in found['plain'][1], 'the test would not see sockets on every interface'


def test_the_flag_opens_the_network(tmp_path) -> None:
    found = talk(tmp_path, {'gate': ('ours', {transport.NETWORK_VARIABLE: '1'})})
    assert '00000000' in found['gate'][1]


@pytest.fixture
def clean(monkeypatch):
    before = dict(os.environ)
    for name in (*STRANGER, transport.NETWORK_VARIABLE, transport.LOCALHOST_ONLY_VARIABLE, 'RMW_IMPLEMENTATION'):
        monkeypatch.delenv(name, raising=False)
    yield monkeypatch
    os.environ.clear()
    os.environ.update(before)


def test_profile_and_range_follow_the_flag_from_process_to_process(clean) -> None:
    assert transport.configure_transport() == []
    assert transport.profile_in_force() == str(ROOT / 'params' / 'fastdds.xml')
    assert os.environ[transport.RANGE_VARIABLE] == 'SYSTEM_DEFAULT'
    clean.setenv(transport.NETWORK_VARIABLE, '1')
    assert transport.configure_transport() == []
    assert transport.profile_in_force() == str(ROOT / 'params' / 'fastdds_network.xml')
    assert os.environ[transport.RANGE_VARIABLE] == 'SUBNET'


@pytest.mark.parametrize('variable', [transport.PROFILE_VARIABLE, transport.OTHER_PROFILE_VARIABLE])
def test_a_profile_of_the_user_stays_in_force(clean, variable) -> None:
    clean.setenv(variable, '/my/profile.xml')
    (warning,) = transport.configure_transport()
    assert 'it decides alone whether other machines can take part' in warning
    # Fast DDS 2 reads no other variable.
    assert os.environ[transport.PROFILE_VARIABLE] == '/my/profile.xml'
    assert os.environ[transport.RANGE_VARIABLE] == 'LOCALHOST'


@pytest.mark.parametrize(
    ('flag', 'variables', 'said'),
    [
        ('0', {transport.RANGE_VARIABLE: 'SUBNET'}, 'nodes stay on this machine'),
        ('0', {'ROS_STATIC_PEERS': '10.0.0.1'}, 'ROS_STATIC_PEERS is set, but nodes stay on this machine'),
        ('1', {transport.RANGE_VARIABLE: 'LOCALHOST'}, 'keeps discovery on this machine'),
        ('1', {transport.LOCALHOST_ONLY_VARIABLE: '1'}, 'keeps discovery on this machine'),
        ('0', {'ROS_SECURITY_ENABLE': 'true'}, 'without ROS_SECURITY_STRATEGY=Enforce'),
    ],
)
def test_a_shell_that_asks_for_something_else_is_told(clean, flag, variables, said) -> None:
    for name, value in ({transport.NETWORK_VARIABLE: flag} | variables).items():
        clean.setenv(name, value)
    (warning,) = transport.configure_transport()
    assert said in warning


def test_a_node_that_cannot_have_the_security_that_is_asked_for_does_not_start(tmp_path) -> None:
    """No keystore; and with one, a Fast DDS without security, as on PyPI, or keys that are missing."""
    (tmp_path / 'keystore' / 'enclaves' / 'gate').mkdir(parents=True)
    command = [sys.executable, '-m', 'raw2drive_ros.nodes.safety_gate', '--ros-args', '--enclave', '/gate']
    asked = {'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce'}
    with reserve_domain(None) as domain:
        for keystore in (tmp_path / 'nowhere', tmp_path / 'keystore'):
            variables = environment_of_a_user(domain, ROS_SECURITY_KEYSTORE=str(keystore), **asked)
            node = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=60)
            assert node.returncode == 1
            assert node.stderr.splitlines()[-1].startswith('error: ')
            assert 'Traceback' not in node.stderr
