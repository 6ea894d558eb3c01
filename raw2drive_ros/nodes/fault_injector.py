"""Fault injector between vehicle, planner and gate: relays every topic of a plan and applies the plan's faults.

It subscribes to `TOPIC` and publishes `/faulty/TOPIC`; the nodes under test are started with that remapping.
"""

from __future__ import annotations

import heapq
import itertools
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from msg_adapters.diagnostics import OK, WARN
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import NodeError
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.faults.plan import behind_injector, load_plans, touched_topics
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, expanded_name, make_subscription, message_class, profile_of
from raw2drive_ros.nodes.runtime import run_node, steady_clock
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ

DELIVER_HZ = 200.0


class FaultInjectorNode(Node):
    """Times of the plan count from the first message that it receives."""

    def __init__(self) -> None:
        super().__init__('fault_injector')
        p = declare(
            self,
            {
                'plans': ('matrix', 'name of a file in params/faults, or a YAML file'),
                'plan': ('', 'which of its plans'),
                'seed': (-1, "seed of what is drawn by chance (-1: the file's)"),
            },
        )
        file = load_plans(p['plans'])
        if p['plan'] not in file.plans:
            raise NodeError(f'plan {p["plan"]!r} is not in {p["plans"]}; it has: {", ".join(file.plans)}')
        self.plan = p['plan']
        faults = file.plans[self.plan]
        self.injector = Injector(faults, p['seed'] if p['seed'] >= 0 else file.seed)
        self.injector.key = load_key(self.context.get_domain_id())
        self.losses = LossCounter()
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        self.waiting: list[tuple[int, int, Publisher, bytes]] = []
        self.order = itertools.count()
        self.said: list[str] = []
        for name in touched_topics(faults):
            spec = topics.BY_NAME[name]
            behind = expanded_name(self, behind_injector(name))
            output = self.create_publisher(message_class(spec.msgtype), behind, profile_of(spec))
            make_subscription(self, name, self._passer(spec, output), self.losses, raw=True)
        self.create_timer(1.0 / DELIVER_HZ, self._deliver, clock=steady_clock())
        self.reported: dict[str, int] = {}
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self._report, clock=steady_clock())
        self.get_logger().info(f'{p["plan"]}: {", ".join(f"{f.kind} {f.topic} from {f.start_s} s" for f in faults)}')

    def _passer(self, spec: topics.TopicSpec, output: Publisher) -> Any:
        def callback(data: bytes) -> None:
            now_ns = self.get_clock().now().nanoseconds
            for due_ns, changed in self.injector.take(spec.name, spec.msgtype, bytes(data), now_ns):
                if due_ns <= now_ns:
                    output.publish(changed)
                else:
                    heapq.heappush(self.waiting, (due_ns, next(self.order), output, changed))
            holds = self.injector.now(now_ns)
            if holds != self.said:
                # Other nodes report the effects of a fault at once, so the fault itself is reported at once too.
                self.said = holds
                self.diagnostics.publish()

        return callback

    def _deliver(self) -> None:
        now_ns = self.get_clock().now().nanoseconds
        while self.waiting and self.waiting[0][0] <= now_ns:
            _, _, output, data = heapq.heappop(self.waiting)
            output.publish(data)

    def _report(self) -> None:
        """Publish diagnostics once a second; log how many messages each fault has affected when that changes."""
        self.diagnostics.publish()
        if self.injector.counts != self.reported:
            self.reported = dict(self.injector.counts)
            self.get_logger().info(', '.join(f'{name}: {count}' for name, count in self.reported.items()))

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        holds = self.injector.now(self.get_clock().now().nanoseconds)
        text = f'{self.plan}: {", ".join(holds) or "no fault now"}'
        return (WARN if holds else OK), text, dict(self.injector.counts)


def main(args: list[str] | None = None) -> int:
    """Run the fault injector and return the exit code."""
    return run_node(FaultInjectorNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
