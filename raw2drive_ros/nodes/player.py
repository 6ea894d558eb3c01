"""Player: publishes the sensor topics of a bag and /clock at a chosen rate; commands are not replayed."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, NodeError
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.runtime import run_node
from raw2drive_ros.recording.bag_reader import begin_ns, messages_in, open_bag
from raw2drive_ros.recording.line_reader import AnyReader, lasts_s, time_lines

SEEK, END, ENDED = 'seek', 'end', 'interrupted'
POLL_S = 0.05
WAIT_S, PATIENT_S = 30.0, 2.0
LONGEST_S = 1e7


def _positive(value: float) -> None:
    if not 0 < value < math.inf:
        raise ValueError(f'rate {value} must be positive')


def _not_negative(value: float) -> None:
    if not 0 <= value < LONGEST_S:
        raise ValueError(f'start_s {value}: give 0 or more, and no more than a bag may last')


class PlayerNode(Node):
    """Publishes the bag's own CDR bytes untouched. Services: ~/pause, ~/step (one stamp further while paused), ~/seek
    (to the parameter `start_s`). A jump back is visible on /clock, and makes the other nodes start again."""

    def __init__(self) -> None:
        super().__init__('player')
        self.p = declare(
            self,
            {
                'bag': ('', 'folder of the bag to play'),
                'rate': (1.0, 'speed relative to recorded time'),
                'start_s': (0.0, "begin so long after the bag's beginning, and where ~/seek goes"),
                'loop': (False, 'begin again at the end'),
                'paused': (False, 'wait for ~/pause or ~/step before the first message'),
                'privileged': (False, 'play privileged topics too'),
                'wait_for_subscribers': (1, 'start when the front camera has so many subscribers'),
            },
            live={'rate': _positive, 'start_s': _not_negative},
        )
        self.played = 0
        self.paused = bool(self.p['paused'])
        self.steps = 0
        self.seek = False
        self.now_ns = 0
        self.lasts_s = 0.0
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_service(Trigger, '~/seek', self._on_seek)

    def run(self, executor: SingleThreadedExecutor) -> None:
        names = set(topics.SENSOR_TOPICS)
        if self.p['privileged']:
            names |= {spec.name for spec in topics.TOPICS if spec.privileged}
        try:
            with open_bag(Path(self.p['bag'])) as reader:
                connections = self._playable([c for c in reader.connections if c.topic in names])
                if not connections:
                    raise NodeError(f'{self.p["bag"]}: has no topic that could be played')
                lines = time_lines(reader)
                if len(lines) > 1:
                    self.get_logger().info(f'time goes back in this bag: {len(lines)} drives, one after the other')
                self.lasts_s = lasts_s(lines)
                self._prepare(connections, executor)
                how = SEEK
                while how == SEEK or (how == END and self.p['loop']):
                    self.seek = False
                    how = self._play(lines, connections, executor)
        except BagError as error:
            raise NodeError(str(error)) from error
        self.get_logger().info(f'played {self.played} messages')

    def _playable(self, connections: list[Any]) -> list[Any]:
        """Those of the table's types: bytes of another type under a known name would be misread by every subscriber."""
        foreign = {c.topic: c.msgtype for c in connections if c.msgtype != topics.BY_NAME[c.topic].msgtype}
        for topic, msgtype in foreign.items():
            self.get_logger().warning(f'{topic} is {msgtype}, not {topics.BY_NAME[topic].msgtype}: not played')
        return [c for c in connections if c.topic not in foreign]

    def _prepare(self, connections: list[Any], executor: SingleThreadedExecutor) -> None:
        self.clock = make_publisher(self, topics.CLOCK)
        self.outputs = {c.topic: make_publisher(self, c.topic) for c in connections}
        front = self.outputs.get(topics.image_topic('front')) or self.outputs.get(topics.compressed_topic('front'))
        deadline, said = time.monotonic() + WAIT_S, False
        while front is not None and front.get_subscription_count() < self.p['wait_for_subscribers']:
            if time.monotonic() > deadline:
                raise NodeError(f'nobody subscribes to the front camera after {WAIT_S:.0f} s')
            executor.spin_once(timeout_sec=0.1)
            if not said and time.monotonic() > deadline - WAIT_S + PATIENT_S:
                said = True
                self.get_logger().info(
                    f'waiting for a planner, for {WAIT_S:.0f} s at most: raw2drive drive --sim-time, in the same domain'
                )

    def _play(self, lines: list[AnyReader], connections: list[Any], executor: SingleThreadedExecutor) -> str:
        left_ns = round(float(self.get_parameter('start_s').value or 0.0) * 1e9)
        for line in lines:
            begins_ns = begin_ns(line)
            lasts_ns = line.end_time - begins_ns
            if left_ns > lasts_ns:
                left_ns -= lasts_ns
                continue
            how = self._play_line(line, connections, begins_ns + left_ns, executor)
            if how != END:
                return how
            left_ns = 0
        if left_ns:
            raise NodeError(f'start_s is beyond the end of the bag, which lasts {self.lasts_s:.1f} s')
        return END

    def _play_line(
        self, line: AnyReader, connections: list[Any], start_ns: int, executor: SingleThreadedExecutor
    ) -> str:
        self._set_clock(start_ns)
        self._publish_latched(line, connections, start_ns)
        anchor_s, anchor_ns, rate = time.monotonic(), start_ns, self._rate()
        for connection, stamp_ns, data in messages_in(line, connections=connections, start=start_ns):
            # One time line of several comes in the order of arrival: a stamp may be a little behind.
            if stamp_ns > self.now_ns:
                was_paused = self.paused
                if was_paused and self._wait_while_paused(executor):
                    return SEEK if self.seek else ENDED
                if was_paused or self._rate() != rate:
                    anchor_s, anchor_ns, rate = time.monotonic(), stamp_ns, self._rate()
                due = anchor_s + (stamp_ns - anchor_ns) * 1e-9 / rate
                while (wait := due - time.monotonic()) > 0 and not self.seek:
                    executor.spin_once(timeout_sec=wait)
                if self.seek:
                    return SEEK
                self._set_clock(stamp_ns)
            self.outputs[connection.topic].publish(bytes(data))
            self.played += 1
        return END

    def _wait_while_paused(self, executor: SingleThreadedExecutor) -> bool:
        """Wait until playing continues; True when it does not continue from here (seek or shutdown)."""
        if self.steps:
            self.steps -= 1
            return False
        while self.paused and not self.steps and not self.seek:
            if not rclpy.ok():
                return True
            executor.spin_once(timeout_sec=POLL_S)
        self.steps = max(0, self.steps - 1)
        return self.seek

    def _publish_latched(self, line: AnyReader, connections: list[Any], start_ns: int) -> None:
        """Publish the last routes and mounting poses from before the start, which are not sent again."""
        latched = [c for c in connections if topics.BY_NAME[c.topic].qos.latched]
        last: dict[str, bytes] = {}
        if latched:
            for connection, _, data in messages_in(line, connections=latched, stop=start_ns):
                last[connection.topic] = bytes(data)
        for topic, data in last.items():
            self.outputs[topic].publish(data)

    def _set_clock(self, stamp_ns: int) -> None:
        self.now_ns = stamp_ns
        message = RclpyFactory().new('rosgraph_msgs/msg/Clock')
        message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
        self.clock.publish(message)

    def _rate(self) -> float:
        return float(self.get_parameter('rate').value or 1.0)

    def _on_pause(self, request: Any, response: Any) -> Any:
        self.paused = bool(request.data)
        response.success, response.message = True, f'{"paused" if self.paused else "playing"} at {self.now_ns} ns'
        return response

    def _on_step(self, request: Any, response: Any) -> Any:
        self.steps += self.paused
        response.success, response.message = self.paused, 'a step' if self.paused else 'pause first'
        return response

    def _on_seek(self, request: Any, response: Any) -> Any:
        start_s = float(self.get_parameter('start_s').value or 0.0)
        self.seek = start_s <= self.lasts_s
        there = f'to {start_s} s' if self.seek else f'start_s {start_s}: the bag lasts {self.lasts_s:.1f} s'
        response.success, response.message = self.seek, there
        return response


def main(args: list[str] | None = None) -> int:
    """Run the player and return the exit code."""
    return run_node(PlayerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
