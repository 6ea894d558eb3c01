"""Recorder: writes every topic of the table into MCAP bags, as raw CDR with the messages' own stamps and, as log_time,
when they were received (system clock)."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from msg_adapters.diagnostics import ERROR, OK, WARN, diagnostics_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagExistsError, DiskFullError, NodeError
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, make_subscription, message_class
from raw2drive_ros.nodes.runtime import StopRequest, run_node, spin, steady_clock
from raw2drive_ros.recording.bag_reader import partial_folder
from raw2drive_ros.recording.recorder import Recording, RingBuffer
from raw2drive_ros.recording.time_lines import stamp_of
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ

DEPTH = 200
DRAIN_QUIET_S = 0.1
DRAIN_LIMIT_S = 0.8


class RecorderNode(Node):
    """Ctrl-C and SIGTERM close the bag after all messages received so far are written. Loss is reported per topic.

    When time goes back (a simulation reset, a bag in a loop, the system clock set back) a new bag begins, and the log
    and /diagnostics say so. With `snapshot_s` the last seconds are kept in memory, and written when ~/save is called or
    the gate stops the car.
    """

    drains = True
    stop: StopRequest

    def __init__(self) -> None:
        super().__init__('recorder')
        p = declare(
            self,
            {
                'bag': ('', 'folder of the bag to write; must not exist'),
                'provenance': ('{}', 'JSON mapping of strings that is kept in the bag'),
                'flush_s': (0.5, 'seconds between flushes to the operating system: the most that a kill can lose'),
                'split_s': (0.0, 'close a bag and begin the next one after so many seconds; 0: never'),
                'split_mb': (0.0, 'and after so many megabytes'),
                'snapshot_s': (0.0, 'keep the last seconds in memory, write them on ~/save or when the gate stops'),
                'stats_file': ('', 'write received and lost counts per topic as JSON here at the end'),
                'fail_on_loss': (False, 'end with an error when a message was lost'),
            },
        )
        if not p['bag']:
            raise NodeError('parameter `bag` is empty; give the folder of the bag to write')
        if p['flush_s'] <= 0 or min(p['split_s'], p['split_mb'], p['snapshot_s']) < 0:
            raise NodeError('flush_s must be positive; split_s, split_mb and snapshot_s must not be negative')
        self.p = p
        self.losses = LossCounter()
        self.failed = ''
        self.clock_ns = self.arrival_ns = 0
        self.provenance = json.loads(p['provenance'])
        self.ring = RingBuffer(p['snapshot_s']) if p['snapshot_s'] else None
        self.recording: Recording | None = None
        self.snapshots: list[str] = []
        self.gate_stopped = False
        if self.ring is None:
            try:
                split = p['split_s'], round(p['split_mb'] * 1e6)
                self.recording = Recording(Path(p['bag']), self.provenance, *split)
            except (BagExistsError, DiskFullError) as error:
                raise NodeError(str(error)) from error
            self.create_timer(p['flush_s'], self._flush, clock=steady_clock())
        self.create_service(Trigger, '~/save', self._on_save)
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady_clock())
        for spec in topics.TOPICS:
            make_subscription(self, spec.name, self._writer(spec.name), self.losses, raw=True, depth=DEPTH)

    def _writer(self, topic: str) -> Any:
        msgtype = topics.BY_NAME[topic].msgtype

        # With two arguments rclpy also gives what the middleware knows of the message.
        def callback(data: bytes, info: Any) -> None:
            if self.failed:
                return
            received_ns = info['received_timestamp'] or time.time_ns()
            stamp_ns = stamp_of(msgtype, data) or 0
            if topic == topics.CLOCK:
                self.clock_ns = stamp_ns
            elif topic == topics.DIAGNOSTICS and self.clock_ns:
                # Nodes without simulated time stamp theirs with the wall clock; a bag has one time base.
                stamp_ns = self.clock_ns
            if self.ring is not None:
                # Age in simulated time where there is one: lock-step is faster or slower than the wall clock.
                self.ring.add(topic, stamp_ns, data, self.clock_ns or self._arrival_ns(received_ns), received_ns)
                if topic == topics.DIAGNOSTICS:
                    self._watch_gate(data)
                return
            try:
                assert self.recording is not None
                self.recording.write(topic, stamp_ns, data, received_ns)
                self._tell()
            except DiskFullError as error:
                self._fail(error)

        return callback

    def _arrival_ns(self, received_ns: int) -> int:
        """When it was received, on the steady clock: while a snapshot is written, messages wait for seconds."""
        waited_ns = max(0, time.time_ns() - received_ns)
        self.arrival_ns = max(self.arrival_ns, time.monotonic_ns() - waited_ns)
        return self.arrival_ns

    def _flush(self) -> None:
        if self.recording is not None and not self.failed:
            try:
                self.recording.flush()
                self._tell()
            except OSError as error:
                self._fail(error)

    def _tell(self) -> None:
        """Log what the recording has to say, such as time that went back."""
        assert self.recording is not None
        if self.recording.notes:
            for text in self.recording.notes:
                self.get_logger().warning(text)
            self.recording.notes.clear()
            self.diagnostics.publish()

    def _fail(self, error: OSError) -> None:
        """Ends the node with an error: a recorder that records nothing must not look alive."""
        self.failed = str(error)
        self.get_logger().error(f'recording stopped: {error}')
        self.diagnostics.publish()

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        values = {'messages': self._received(), 'messages_lost': self.losses.total, 'snapshots': len(self.snapshots)}
        if self.failed:
            return ERROR, f'recording stopped: {self.failed}', values
        if self.recording is None:
            return WARN if self.losses.total else OK, f'holding the last {self.p["snapshot_s"]:g} s', values
        back, strays, untimed = self.recording.went_back, self.recording.strays, self.recording.untimed
        values |= {'time_went_back': len(back), 'bags_closed': len(self.recording.bags)}
        values |= {f'stamps_back{topic}': count for topic, count in strays.items()}
        values |= {f'without_time{topic}': count for topic, count in untimed.items()}
        doing = 'recording'
        if back:
            doing += f'; {back[-1]}: a new bag was begun'
        elif strays or untimed:
            doing += f'; stamps of {", ".join(sorted(strays | untimed))} do not tell the time'
        return WARN if self.losses.total or back or strays or untimed else OK, doing, values

    def _watch_gate(self, data: bytes) -> None:
        """Save a snapshot when the safety gate stops the car: what led to the stop is still in memory."""
        message = deserialize_message(data, message_class('diagnostic_msgs/msg/DiagnosticArray'))
        for name, level, text, values in diagnostics_from_message(message):
            if not name.endswith('safety_gate'):
                continue
            stopped = level >= ERROR and values.get('state', '').endswith('stop')
            if stopped and not self.gate_stopped:
                self.get_logger().warning(f'the gate stopped the car: {text}')
                self._save(f'gate: {text}')
            self.gate_stopped = stopped

    def _on_save(self, request: Any, response: Any) -> Any:
        if self.ring is None:
            response.success, response.message = False, 'recording everything already; snapshot_s keeps a snapshot'
        else:
            response.message = self._save('~/save')
            response.success = not response.message.startswith('nothing')
        return response

    def _save(self, why: str) -> str:
        assert self.ring is not None
        path = self._next_snapshot()
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            count = self.ring.save(path, self.provenance | {'snapshot': why})
        except (BagExistsError, DiskFullError) as error:
            self.get_logger().error(str(error))
            return f'nothing written: {error}'
        if not count:
            return 'nothing has arrived yet'
        self.snapshots.append(str(path))
        self.get_logger().info(f'{path}: {count} messages')
        return str(path)

    def _next_snapshot(self) -> Path:
        """The next free number: also after a restart, and past unfinished snapshots of a killed recorder."""
        number = len(self.snapshots)
        while True:
            path = Path(self.p['bag']) / f'snapshot_{number:03d}'
            if not path.exists() and not partial_folder(path).exists():
                return path
            number += 1

    def _received(self) -> int:
        if self.ring is not None:
            return len(self.ring.held)
        return sum(self.recording.received.values()) if self.recording is not None else 0

    def run(self, executor: SingleThreadedExecutor) -> None:
        spin(self, executor, until=lambda: self.stop.requested or bool(self.failed))
        # Messages that are queued already belong in the bag: take them until no more arrive.
        deadline = time.monotonic() + DRAIN_LIMIT_S
        seen = -1
        while seen != (now := self._received()) and time.monotonic() < deadline:
            seen = now
            quiet_at = time.monotonic() + DRAIN_QUIET_S
            while time.monotonic() < quiet_at:
                executor.spin_once(timeout_sec=0.01)
        if self.failed or (self.p['fail_on_loss'] and self.losses.total):
            self.close()
            raise NodeError(self.failed or f'{self.losses.total} messages lost: {self.losses.lost}')

    def close(self) -> None:
        if self.recording is None and self.ring is None:
            return
        recording, self.recording = self.recording, None
        bags = [str(bag) for bag in recording.close()] if recording is not None else self.snapshots
        for text in recording.notes if recording is not None else ():
            self.get_logger().warning(text)
        self.ring = None
        gaps = recording.largest_gap_ns if recording is not None else {}
        report = {
            'bag': self.p['bag'],
            'bags': bags,
            'received': recording.counts if recording is not None else {},
            'lost': self.losses.lost,
            'largest_gap_s': {topic: round(gap * 1e-9, 3) for topic, gap in gaps.items()},
            'messages_lost': self.losses.total,
            'time_went_back': recording.went_back if recording is not None else [],
            'failed': self.failed,
        }
        if self.p['stats_file']:
            Path(self.p['stats_file']).write_text(json.dumps(report))


def main(args: list[str] | None = None) -> int:
    """Run the recorder and return the exit code."""
    return run_node(RecorderNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
