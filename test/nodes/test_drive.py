"""`raw2drive drive` on the example vehicle: when a node dies or the user ends it, the gate first stops the car."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.graph.processes import reserve_domain, running_graph

ROOT = Path(__file__).resolve().parents[2]
WATCH = """
import rclpy
from msg_adapters.sensors import odometry_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import LossCounter, make_subscription
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node = rclpy.create_node('watch')
make_subscription(
    node, topics.ODOMETRY, lambda m: print(round(odometry_from_message(m).speed_mps, 3), flush=True), LossCounter()
)
rclpy.spin(node)
"""


@pytest.mark.parametrize('how', ['planner killed', 'ctrl-c'])
def test_the_gate_stops_the_car_before_everything_ends(tmp_path, how) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        for name, arguments in {
            'toy': [str(ROOT / 'examples' / 'vehicle_interface' / 'toy_vehicle.py')],
            'watch': ['-c', WATCH],
        }.items():
            graph.processes[name] = subprocess.Popen(
                [sys.executable, *arguments], cwd=ROOT, env=graph.environment, stdout=subprocess.PIPE, text=True
            )
        gate = str(ROOT / 'examples' / 'vehicle_interface' / 'gate.yaml')
        command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'drive', '--domain', str(domain), '--gate', gate]
        drive = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        watch = graph.processes['watch'].stdout
        try:
            deadline, again = time.monotonic() + 90.0, time.monotonic() + 15.0
            while float(watch.readline()) < 2.0:
                assert time.monotonic() < deadline, 'it never drove'
                if time.monotonic() > again:
                    # On a busy machine the gate may see 0.3 s of silence in its first second and latch a stop.
                    again += 15.0
                    main(['call', '/safety_gate/activate', '--domain', str(domain)])
            if how == 'ctrl-c':
                drive.send_signal(signal.SIGINT)
            else:
                nodes = psutil.Process(drive.pid).children()
                (planner,) = [node for node in nodes if any('nodes.planner' in part for part in node.cmdline())]
                os.kill(planner.pid, signal.SIGKILL)
            said = drive.communicate(timeout=60.0)[1]
        finally:
            # Its gate and planner end with it; left alone they would command the cars of other tests.
            drive.kill()
        graph.processes['watch'].terminate()
        speeds = [float(line) for line in watch if line.strip()]
    assert drive.returncode == (130 if how == 'ctrl-c' else 1)
    if how != 'ctrl-c':
        assert 'planner was killed by SIGKILL; safety_gate goes on' in said
        assert 'comfortable_stop: no valid proposal' in said
    assert speeds[-1] == 0.0
