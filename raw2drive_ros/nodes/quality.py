"""Names and QoS of endpoints from the topic table, and counting of messages that DDS reports as lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSPublisherEventType,
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics

_FACTORY = RclpyFactory()
# Two tuples: events of publishers and subscriptions compare as integers, and their values overlap.
_PUBLISHER_DISCOVERY = (
    QoSPublisherEventType.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS,
    QoSPublisherEventType.RCL_PUBLISHER_INCOMPATIBLE_TYPE,
)
_SUBSCRIPTION_DISCOVERY = (
    QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
    QoSSubscriptionEventType.RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE,
)
# The window is longer than the time-out of any node's spin, so that a spin begins in every window.
_WINDOW_S, _PERIOD_S = 0.25, 1.0


def expanded_name(node: Node, topic: str) -> str:
    """The name to create an endpoint with, for a topic of the table: in the node's namespace, not yet remapped."""
    return node.resolve_topic_name(_relative(topic), only_expand=True)


def resolved_name(node: Node, topic: str) -> str:
    """The name that an endpoint of this node for a topic of the table really has: after namespace and remapping."""
    return node.resolve_topic_name(_relative(topic))


def _relative(topic: str) -> str:
    return topic if topic in topics.SHARED else topic.removeprefix('/')


def publisher_count(node: Node, topic: str) -> int:
    """Publishers known so far on the resolved name of a topic of the table; rclpy alone would not apply remapping."""
    return node.count_publishers(resolved_name(node, topic))


def subscriber_count(node: Node, topic: str) -> int:
    """Subscribers known so far on the resolved name of a topic of the table."""
    return node.count_subscribers(resolved_name(node, topic))


def message_class(msgtype: str) -> Any:
    """The rclpy class of e.g. 'sensor_msgs/msg/Image'."""
    return type(_FACTORY.new(msgtype))


def profile_of(spec: topics.TopicSpec, depth: int | None = None) -> QoSProfile:
    """The rclpy QoS profile of a topic. depth: messages to queue, in place of the table's."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or spec.qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if spec.qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if spec.qos.latched else DurabilityPolicy.VOLATILE,
    )


class LossCounter:
    """Counts lost messages by topic, from the QoS event MESSAGE_LOST."""

    def __init__(self) -> None:
        self.lost: dict[str, int] = {}

    @property
    def total(self) -> int:
        return sum(self.lost.values())

    def events(self, topic: str) -> SubscriptionEventCallbacks:
        def on_lost(info: Any) -> None:
            self.lost[topic] = self.lost.get(topic, 0) + int(info.total_count_change)

        return SubscriptionEventCallbacks(message_lost=on_lost)


class _WindowedGroup(ReentrantCallbackGroup):
    """A callback group that is handled in one window of each second only.

    rclpy builds its wait set again for nearly every message, and each event of each topic adds to the cost.
    """

    def can_execute(self, entity: Any) -> bool:
        return time.monotonic() % _PERIOD_S < _WINDOW_S


def _handle_in_windows(endpoint: Any, events: tuple[Any, ...]) -> Any:
    """Put these events into a `_WindowedGroup`: rclpy warns of incompatible peers a few _PERIOD_S later."""
    group = _WindowedGroup()
    for handler in endpoint.event_handlers:
        if handler.event_type in events:
            handler.callback_group = group
            group.add_entity(handler)
    return endpoint


def make_publisher(node: Node, topic: str) -> Publisher:
    """A publisher with type and QoS of the topic table."""
    spec = topics.BY_NAME[topic]
    return _handle_in_windows(
        node.create_publisher(
            message_class(spec.msgtype),
            expanded_name(node, topic),
            profile_of(spec, spec.qos.kept or None),
            event_callbacks=PublisherEventCallbacks(),
        ),
        _PUBLISHER_DISCOVERY,
    )


def make_subscription(
    node: Node,
    topic: str,
    callback: Callable[[Any], None],
    losses: LossCounter,
    *,
    raw: bool = False,
    depth: int | None = None,
    best_effort: bool = False,
) -> Subscription:
    """A subscription with type and QoS of the topic table; its lost messages are counted in `losses`.

    raw: the callback takes CDR bytes instead of messages. depth: messages to queue, in place of the table's.
    best_effort: take a publisher that offers no more; latched topics stay reliable.
    """
    spec = topics.BY_NAME[topic]
    profile = profile_of(spec, depth)
    if best_effort and not spec.qos.latched:
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    return _handle_in_windows(
        node.create_subscription(
            message_class(spec.msgtype),
            expanded_name(node, topic),
            callback,
            profile,
            raw=raw,
            event_callbacks=losses.events(topic),
        ),
        _SUBSCRIPTION_DISCOVERY,
    )
