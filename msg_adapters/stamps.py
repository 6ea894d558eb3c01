"""builtin_interfaces/Time to and from nanoseconds."""

from __future__ import annotations

from typing import Any


def set_stamp(stamp: Any, stamp_ns: int) -> None:
    """Write nanoseconds since the clock's epoch into a Time message."""
    stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)


def stamp_ns(stamp: Any) -> int:
    """Nanoseconds since the clock's epoch."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
