"""One `/diagnostics` line per node: level, cause, and key values."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from msg_adapters.diagnostics import diagnostics_to_message
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import make_publisher


class DiagnosticsPublisher:
    """Publishes what `describe()` returns: (level 0..3, message, values); at 1 Hz by wall clock.

    Under the node's name; with its namespace where it has one, because all cars of a domain may share /diagnostics.
    """

    def __init__(self, node: Node, describe: Any) -> None:
        self.node, self.describe = node, describe
        self.name = node.get_name() if node.get_namespace() == '/' else node.get_fully_qualified_name()
        self.publisher = make_publisher(node, topics.DIAGNOSTICS)
        self.factory = RclpyFactory()

    def publish(self) -> None:
        level, message, values = self.describe()
        stamp_ns = self.node.get_clock().now().nanoseconds
        self.publisher.publish(diagnostics_to_message(self.factory, self.name, level, message, values, stamp_ns))
