"""Recorder: every topic of the table into one MCAP bag, as raw CDR, stamped with the messages' own stamps."""

from __future__ import annotations

import json
import struct
import time
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from raw2drive_ros import topics
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, make_subscription
from raw2drive_ros.nodes.runtime import NodeError, StopRequest, run_node, spin
from raw2drive_ros.recording.bag_writer import BagExistsError, BagWriter, DiskFullError

DEPTH = 200
DRAIN_QUIET_S = 0.1
DRAIN_LIMIT_S = 0.8


class RecorderNode(Node):
    """Ctrl-C and SIGTERM close the bag, after what has arrived by then is written. Loss is reported per topic."""

    drains = True
    stop: StopRequest

    def __init__(self) -> None:
        super().__init__('recorder')
        p = declare(
            self,
            {
                'bag': ('', 'folder of the bag to write; must not exist'),
                'provenance': ('{}', 'JSON mapping of strings that is kept in the bag'),
                'stats_file': ('', 'write received and lost counts per topic as JSON here at the end'),
            },
        )
        if not p['bag']:
            raise NodeError('parameter `bag` is empty; give the folder of the bag to write')
        self.p = p
        self.losses = LossCounter()
        self.failed = ''
        self.clock_ns = 0
        try:
            self.bag = BagWriter(Path(p['bag']), json.loads(p['provenance']))
        except (BagExistsError, DiskFullError) as error:
            raise NodeError(str(error)) from error
        for spec in topics.TOPICS:
            make_subscription(self, spec.name, self._writer(spec.name), self.losses, raw=True, depth=DEPTH)

    def _writer(self, topic: str) -> Any:
        def callback(data: bytes) -> None:
            if self.failed:
                return
            # After the 4-byte CDR header, every type of the table starts with its stamp.
            sec, nanosec = struct.unpack_from('<iI', data, 4)
            stamp_ns = sec * 1_000_000_000 + nanosec
            if topic == topics.CLOCK:
                self.clock_ns = stamp_ns
            elif topic == topics.DIAGNOSTICS and self.clock_ns:
                # Nodes without simulated time stamp theirs by the wall; the bag has one time line.
                stamp_ns = self.clock_ns
            try:
                self.bag.write_raw(topic, stamp_ns, data)
            except DiskFullError as error:
                self.failed = str(error)
                self.get_logger().error(f'recording stopped: {error}')

        return callback

    def run(self, executor: SingleThreadedExecutor) -> None:
        spin(self, executor, until=lambda: self.stop.requested)
        # Messages that are in the queues already belong into the bag: take them until none comes any more.
        deadline = time.monotonic() + DRAIN_LIMIT_S
        seen = -1
        while seen != (now := sum(self.bag.counts.values())) and time.monotonic() < deadline:
            seen = now
            quiet_at = time.monotonic() + DRAIN_QUIET_S
            while time.monotonic() < quiet_at:
                executor.spin_once(timeout_sec=0.01)

    def close(self) -> None:
        path = self.bag.close()
        report = {
            'bag': str(path),
            'received': self.bag.counts,
            'lost': self.losses.lost,
            'messages_lost': self.losses.total,
            'failed': self.failed,
        }
        if self.p['stats_file']:
            Path(self.p['stats_file']).write_text(json.dumps(report))


def main(args: list[str] | None = None) -> int:
    return run_node(RecorderNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
