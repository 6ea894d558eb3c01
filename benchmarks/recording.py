"""Is anything lost when six cameras are recorded at full rate? python -m benchmarks.recording [--seconds 60]

One process publishes six 224x400 pictures of noise (the hardest to compress) at 20 Hz, the recorder is another.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from raw2drive_ros.contracts import topics
from raw2drive_ros.graph.processes import reserve_domain, running_graph

PUBLISHER = """
import sys, time
import numpy as np
import rclpy
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import fill_image, new_image
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, factory = rclpy.create_node('cameras'), RclpyFactory()
height, width, rate, seconds = (int(a) for a in sys.argv[1:5])
outputs = {c: make_publisher(node, topics.image_topic(c)) for c in topics.CAMERAS}
messages = {c: new_image(factory, c, height, width) for c in topics.CAMERAS}
rng = np.random.default_rng(0)
pictures = rng.integers(0, 255, (8, height, width, 3), np.uint8)
while min(o.get_subscription_count() for o in outputs.values()) < 1:
    time.sleep(0.1)
time.sleep(1.0)
due = time.monotonic()
for tick in range(seconds * rate):
    for number, camera in enumerate(topics.CAMERAS):
        fill_image(messages[camera], pictures[(tick + number) % 8], time.time_ns())
        outputs[camera].publish(messages[camera])
    due += 1.0 / rate
    time.sleep(max(0.0, due - time.monotonic()))
print(6 * seconds * rate, time.monotonic() - due)
time.sleep(1.0)
"""


def main() -> None:
    """Publish and record; print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=int, default=60)
    parser.add_argument('--rate', type=int, default=20)
    parser.add_argument('--size', default='224x400')
    options = parser.parse_args()
    height, width = options.size.split('x')
    with (
        tempfile.TemporaryDirectory(dir='.') as folder,
        reserve_domain(None) as domain,
        running_graph(Path(folder), domain) as graph,
    ):
        stats = Path(folder) / 'stats.json'
        graph.start('recorder', {'bag': str(Path(folder) / 'bag'), 'stats_file': str(stats)}, sim_time=False)
        command = [sys.executable, '-c', PUBLISHER, height, width, str(options.rate), str(options.seconds)]
        started = time.monotonic()
        sent, late_s = subprocess.run(
            command, env=graph.environment, capture_output=True, text=True, check=True
        ).stdout.split()
        lasted_s = time.monotonic() - started
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        graph.end(order=('recorder',))
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        report = json.loads(stats.read_text())
        size = sum(f.stat().st_size for f in (Path(folder) / 'bag').iterdir())
    received = sum(report['received'].get(topics.image_topic(camera), 0) for camera in topics.CAMERAS)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print('| pictures sent | recorded | reported lost | publisher late by | MB/s on disk | recorder, share of a core |')
    print('|---|---|---|---|---|---|')
    print(
        f'| {sent} | {received} | {report["messages_lost"]} | {1e3 * float(late_s):.0f} ms '
        f'| {size / 1e6 / options.seconds:.1f} | {100 * cpu_s / lasted_s:.0f} % |'
    )


if __name__ == '__main__':
    main()
