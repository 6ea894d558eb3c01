"""The enclaves of `raw2drive security policies` allow what real nodes open."""

import json
import subprocess
import sys
import time
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.graph.security_policy import enclaves

ROOT = Path(__file__).parents[2]
# Prints, per node, what it publishes, hears, offers and requests, once that has not changed for five seconds.
PROBE = """
import json, sys, time
import rclpy
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, names = rclpy.create_node('probe'), sys.argv[1:]
def look():
    kinds = [node.get_publisher_names_and_types_by_node, node.get_subscriber_names_and_types_by_node,
             node.get_service_names_and_types_by_node, node.get_client_names_and_types_by_node]
    return {name: [sorted(found for found, _ in kind(name, '/car1')) for kind in kinds] for name in names}
seen, since, end = {}, time.monotonic(), time.monotonic() + 60.0
while time.monotonic() < end and time.monotonic() < since + 5.0:
    rclpy.spin_once(node, timeout_sec=0.2)
    if set(names) <= {n for n, space in node.get_node_names_and_namespaces() if space == '/car1'}:
        now = look()
        if now != seen or not all(now[name][0] for name in names):
            seen, since = now, time.monotonic()
    else:
        since = time.monotonic()
print(json.dumps(seen))
"""


def test_every_endpoint_of_a_real_graph_is_allowed_by_its_enclave(bundle, tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain, '/car1') as graph:
        graph.start('recorder', {'bag': str(tmp_path / 'bag')})
        graph.start('safety_gate', {'clock': 'ros', 'simulated': True})
        graph.start('planner', {'bundle': str(bundle)})
        graph.start('command_adapter', {'output': 'twist'})
        # It waits for more subscribers than there are, so that nothing changes meanwhile.
        graph.start('bridge', {'wait_for_sensor_subscribers': 9}, sim_time=False)
        while 'bundle' not in (tmp_path / 'planner.log').read_text():
            graph.check()
            time.sleep(0.2)
        probe = subprocess.run(
            [sys.executable, '-c', PROBE, *graph.processes],
            cwd=ROOT,
            env=graph.environment,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        seen = json.loads(probe.stdout.splitlines()[-1])
    for enclave in enclaves():
        if enclave.node in seen:
            rules = (
                (*enclave.publishes, *enclave.other),
                enclave.hears,
                [f'{enclave.node}/{name}' for name in enclave.offers],
                enclave.requests,
            )
            for names, rule in zip(seen[enclave.node], rules, strict=True):
                # rosout and parameter_events are of the whole domain.
                full = {n if n in ('/rosout', '/parameter_events') else f'/car1/{n.lstrip("/")}' for n in rule}
                assert set(names) <= full, enclave.node
    assert '/car1/control/command' in seen['safety_gate'][0]
    assert '/car1/planner/change_state' in seen['planner'][2]
