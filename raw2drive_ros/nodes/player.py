"""Player: the sensor topics of a bag into the graph, with /clock, at a rate; commands are not replayed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from msg_adapters.factory import RclpyFactory
from raw2drive_ros import topics
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.runtime import NodeError, run_node
from raw2drive_ros.recording.bag_reader import BagError, open_bag


class PlayerNode(Node):
    """Publishes the bag's own CDR bytes untouched."""

    def __init__(self) -> None:
        super().__init__('player')
        self.p = declare(
            self,
            {
                'bag': ('', 'folder of the bag to play'),
                'rate': (1.0, 'speed relative to recorded time'),
                'privileged': (False, 'play privileged topics too'),
                'wait_for_subscribers': (1, 'start when the front camera has so many subscribers'),
            },
        )
        if not self.p['rate'] > 0:
            raise NodeError(f'rate {self.p["rate"]} must be positive')
        self.played = 0

    def run(self, executor: SingleThreadedExecutor) -> None:
        names = set(topics.SENSOR_TOPICS)
        if self.p['privileged']:
            names |= {spec.name for spec in topics.TOPICS if spec.privileged}
        try:
            with open_bag(Path(self.p['bag'])) as reader:
                connections = [c for c in reader.connections if c.topic in names]
                self._play(reader, connections, executor)
        except BagError as error:
            raise NodeError(str(error)) from error

    def _play(self, reader: Any, connections: list[Any], executor: SingleThreadedExecutor) -> None:
        clock = make_publisher(self, topics.CLOCK)
        outputs = {c.topic: make_publisher(self, c.topic) for c in connections}
        front = outputs.get(topics.image_topic('front'))
        deadline = time.monotonic() + 30.0
        while front is not None and front.get_subscription_count() < self.p['wait_for_subscribers']:
            if time.monotonic() > deadline:
                raise NodeError('nobody subscribes to the front camera after 30 s')
            executor.spin_once(timeout_sec=0.1)
        factory = RclpyFactory()
        first_ns, last_ns, started = None, None, time.monotonic()
        for connection, stamp_ns, data in reader.messages(connections=connections):
            if first_ns is None:
                first_ns = stamp_ns
            due = started + (stamp_ns - first_ns) * 1e-9 / self.p['rate']
            while (wait := due - time.monotonic()) > 0:
                executor.spin_once(timeout_sec=wait)
            if stamp_ns != last_ns:
                message = factory.new('rosgraph_msgs/msg/Clock')
                message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
                clock.publish(message)
                last_ns = stamp_ns
            outputs[connection.topic].publish(bytes(data))
            self.played += 1
        self.get_logger().info(f'played {self.played} messages')


def main(args: list[str] | None = None) -> int:
    return run_node(PlayerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
