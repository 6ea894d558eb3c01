"""QoS profiles from the topic table, and counting of messages that DDS reports as lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from msg_adapters.factory import RclpyFactory
from raw2drive_ros import topics

_FACTORY = RclpyFactory()


def message_class(msgtype: str) -> Any:
    return type(_FACTORY.new(msgtype))


def profile_of(spec: topics.TopicSpec, depth: int | None = None) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or spec.depth,
        reliability=ReliabilityPolicy.RELIABLE if spec.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if spec.latched else DurabilityPolicy.VOLATILE,
    )


class LossCounter:
    """Messages lost per topic, from the QoS event of the same name."""

    def __init__(self) -> None:
        self.lost: dict[str, int] = {}

    @property
    def total(self) -> int:
        return sum(self.lost.values())

    def events(self, topic: str) -> SubscriptionEventCallbacks:
        def on_lost(info: Any) -> None:
            self.lost[topic] = self.lost.get(topic, 0) + int(info.total_count_change)

        return SubscriptionEventCallbacks(message_lost=on_lost)


def make_publisher(node: Node, topic: str) -> Publisher:
    spec = topics.BY_NAME[topic]
    return node.create_publisher(
        message_class(spec.msgtype), topic, profile_of(spec), event_callbacks=PublisherEventCallbacks()
    )


def make_subscription(
    node: Node,
    topic: str,
    callback: Callable[[Any], None],
    losses: LossCounter,
    *,
    raw: bool = False,
    depth: int | None = None,
) -> Subscription:
    spec = topics.BY_NAME[topic]
    return node.create_subscription(
        message_class(spec.msgtype),
        topic,
        callback,
        profile_of(spec, depth),
        raw=raw,
        event_callbacks=losses.events(topic),
    )
