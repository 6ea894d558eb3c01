"""Two participants for `raw2drive attack`: one that watches a graph, and a stranger who publishes into it."""

from __future__ import annotations

import copy
import threading
import time
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

from msg_adapters.signatures import is_authentic
from msg_adapters.vehicle_status import status_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription

CAPTURED = 100


class _Participant:
    """A node in a DDS participant of its own, spun by a thread."""

    def __init__(self, name: str, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.ends = False
        self.thread = threading.Thread(target=self._spin, daemon=True)
        self.thread.start()

    def _spin(self) -> None:
        while not self.ends:
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self.ends = True
        self.thread.join(2.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Watcher(_Participant):
    """What is true in the graph: the speed by signed status, and messages that a stranger could have captured."""

    def __init__(self, domain: int) -> None:
        self.key = load_key(domain)
        self.speeds: deque[tuple[float, float]] = deque(maxlen=20_000)
        self.stamp_s = 0.0
        self.captured = {name: deque[Any](maxlen=CAPTURED) for name in (*topics.SIGNED, topics.ODOMETRY)}
        super().__init__('watcher', domain)
        losses = LossCounter()
        for name, heard in self.captured.items():
            if name != topics.STATUS:
                make_subscription(self.node, name, lambda message, heard=heard: heard.append(message), losses)
        make_subscription(self.node, topics.STATUS, self._on_status, losses)

    def _on_status(self, message: Any) -> None:
        if not is_authentic(message, topics.STATUS, self.key):
            return
        self.captured[topics.STATUS].append(message)
        status = status_from_message(message)
        if status.speed_mps is not None and status.stamp_ns * 1e-9 >= self.stamp_s:
            self.stamp_s = status.stamp_ns * 1e-9
            self.speeds.append((time.monotonic(), status.speed_mps))

    @property
    def speed_mps(self) -> float | None:
        return self.speeds[-1][1] if self.speeds else None

    def since(self, started: float) -> list[tuple[float, float]]:
        """(seconds after `started`, m/s); `started` on the monotonic clock."""
        return [(at - started, speed) for at, speed in list(self.speeds) if at >= started]

    def call(self, service: str, kind: type, request: Any = None, timeout_s: float = 5.0) -> Any:
        """The answer of a service, None when there is none in time."""
        client = self.node.create_client(kind, service)
        try:
            if not client.wait_for_service(timeout_sec=timeout_s):
                return None
            future = client.call_async(request if request is not None else kind.Request())
            deadline = time.monotonic() + timeout_s
            while not future.done() and time.monotonic() < deadline:
                time.sleep(0.01)
            return future.result() if future.done() else None
        finally:
            self.node.destroy_client(client)


class Stranger(_Participant):
    """Publishes on any topic of the table, without knowing the key."""

    def __init__(self, domain: int) -> None:
        super().__init__('stranger', domain)
        self.publishers: dict[str, Publisher] = {}

    def publisher(self, topic: str) -> Publisher:
        """A publisher that has found all subscribers: what is measured is the reaction, not the discovery."""
        if topic not in self.publishers:
            made = self.publishers[topic] = make_publisher(self.node, topic)
            deadline = time.monotonic() + 1.0
            while time.monotonic() < deadline:
                known = self.node.count_subscribers(made.topic_name)
                if known and made.get_subscription_count() >= known:
                    break
                time.sleep(0.01)
        return self.publishers[topic]


def changed(message: Any, names: Sequence[str], values: Sequence[float]) -> Any:
    """A captured JointState with other values under its old signature."""
    found = copy.deepcopy(message)
    for name, value in zip(names, values, strict=True):
        found.position[list(found.name).index(name)] = value
    return found
