"""Shared by the tests of recordings: serialised messages, read from a bag or made."""

from pathlib import Path

import numpy as np

from msg_adapters.diagnostics import diagnostics_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message, route_to_message
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import OdometrySample, Route
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.time_lines import stamp_of

# Made once: it takes a tenth of a second.
FACTORY = RosbagsFactory()


def messages_of(bag: Path) -> list[tuple[str, int, bytes]]:
    with open_bag(bag) as reader:
        return [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]


def raw_message(topic: str, stamp_ns: int, x_m: float = 0.0) -> tuple[str, int, bytes]:
    if topic == topics.ROUTE:
        message = route_to_message(FACTORY, Route(stamp_ns, np.array([[0.0, 0.0], [30.0, 0.0]])))
    elif topic == topics.DIAGNOSTICS:
        message = diagnostics_to_message(FACTORY, 'x', 0, 'fine', {}, stamp_ns)
    else:
        message = odometry_to_message(FACTORY, OdometrySample(stamp_ns, x_m, 0.0, 0.0, 0.0, 0.0))
    return topic, stamp_ns, FACTORY.serialize(message, topics.BY_NAME[topic].msgtype)


def restamped(row: tuple[str, int, bytes], by_ns: int) -> tuple[str, int, bytes]:
    """The message with a later stamp (earlier, where negative), in its header and beside it."""
    topic, stamp_ns, data = row
    msgtype = topics.BY_NAME[topic].msgtype
    own_ns = stamp_of(msgtype, data)
    assert own_ns is not None
    message = FACTORY.deserialize(data, msgtype)
    set_stamp(message.header.stamp, own_ns + by_ns)
    return topic, stamp_ns + by_ns, FACTORY.serialize(message, msgtype)
