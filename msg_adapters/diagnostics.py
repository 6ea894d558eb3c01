"""diagnostic_msgs/DiagnosticArray with one status."""

from __future__ import annotations

from typing import Any

from msg_adapters.factory import MessageFactory, RclpyFactory
from msg_adapters.stamps import set_stamp

OK, WARN, ERROR, STALE = range(4)


def diagnostics_to_message(
    factory: MessageFactory, name: str, level: int, text: str, values: dict[str, Any], time_ns: int
) -> Any:
    """level: OK, WARN, ERROR or STALE. values become KeyValue strings."""
    array = factory.new('diagnostic_msgs/msg/DiagnosticArray')
    set_stamp(array.header.stamp, time_ns)
    status = factory.new('diagnostic_msgs/msg/DiagnosticStatus')
    # rclpy maps `byte` to bytes of length one, rosbags to an int.
    status.level = bytes([level]) if isinstance(factory, RclpyFactory) else level
    status.name, status.message, status.hardware_id = f'raw2drive: {name}', text, 'raw2drive'
    pairs = []
    for key, value in values.items():
        pair = factory.new('diagnostic_msgs/msg/KeyValue')
        pair.key, pair.value = key, str(value)
        pairs.append(pair)
    status.values = pairs
    array.status = [status]
    return array


def diagnostics_from_message(message: Any) -> list[tuple[str, int, str, dict[str, str]]]:
    """(name, level, text, values) per status."""
    found = []
    for status in message.status:
        level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
        found.append((str(status.name), level, str(status.message), {v.key: v.value for v in status.values}))
    return found
