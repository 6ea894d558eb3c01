"""A recorder that was busy for a moment gets every proposal; those who obey proposals queue the newest only."""

import json
import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.nodes.transport import child_environment

ROOT = Path(__file__).parents[2]
# argv: 'listen', or nothing for the publisher, which stops its listener for 30 of 100 proposals. More messages than a
# receive port of Fast DDS holds (512) come meanwhile, as those of 28 topics do.
PROGRAM = """
import json, os, signal, subprocess, sys, time
import rclpy
from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.privileged import advice_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node, factory = rclpy.create_node('probe'), RclpyFactory()
if sys.argv[1:] == ['listen']:
    heard, losses = [], LossCounter()
    for topic, depth in ((topics.PROPOSED, 200), (topics.ADVICE, 200)):
        keep = heard.append if topic == topics.PROPOSED else (lambda message: None)
        make_subscription(node, topic, keep, losses, depth=depth)
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline and (not heard or heard[-1].header.stamp.sec < 100):
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps([message.header.stamp.sec for message in heard]))
else:
    proposals, other = make_publisher(node, topics.PROPOSED), make_publisher(node, topics.ADVICE)
    listener = subprocess.Popen([sys.executable, __file__, 'listen'])
    while min(proposals.get_subscription_count(), other.get_subscription_count()) < 1:
        time.sleep(0.05)
    for number in range(1, 101):
        if number in (30, 60):
            os.kill(listener.pid, signal.SIGSTOP if number == 30 else signal.SIGCONT)
        proposals.publish(decision_to_message(factory, Decision(number * 10**9, Control())))
        for _ in range(40):
            other.publish(advice_to_message(factory, 1, number * 10**9))
        time.sleep(0.02)
    listener.wait()
node.destroy_node()
rclpy.shutdown()
"""


def test_a_listener_that_was_stopped_for_a_moment_gets_every_proposal(tmp_path) -> None:
    program = tmp_path / 'program.py'
    program.write_text(PROGRAM)
    with reserve_domain(None) as domain:
        environment = child_environment(domain) | {'PYTHONPATH': str(ROOT)}
        run = subprocess.run(
            [sys.executable, str(program)], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=90
        )
    assert run.returncode == 0, run.stderr[-2000:]
    assert json.loads(run.stdout.splitlines()[-1]) == list(range(1, 101))
