"""A closed-loop drive of the raw policy in which messages are lost, delayed, frozen or corrupted on their way.

Every message is serialised, goes through the injector, and reaches the same planner and gate that the ROS nodes run.
Time runs in lock-step: messages that are due by a tick are delivered before that tick's decision.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.vehicle_status import status_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.command_receiver import CommandReceiver
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.gate_inputs import GateInputs
from raw2drive_ros.driving.gate_state import STOPS, Moment
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.evaluation.episode import result_of
from raw2drive_ros.evaluation.metrics import RouteResult
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.rates import ROUTE_EVERY_TICKS
from raw2drive_ros.timing import load_timing

OnTick = Callable[[Tick, Gate], None]


@dataclass(slots=True)
class FaultyDrive:
    """The record of a drive under faults.

    stop_s: when gate or vehicle began to stop the car, in seconds since the drive's start; None: never. stop_state: the
    gate's last state in that stop, or 'vehicle'. stand_s: when the car then stood. reason: why it was stopped. causes:
    everything that the planner's monitor found, in order of appearance. counts: messages touched by the injector.
    """

    result: RouteResult
    controls: list[Control] = field(default_factory=list)
    stop_s: float | None = None
    stop_state: str = ''
    stand_s: float | None = None
    reason: str = ''
    causes: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)


class _Wire:
    """Messages on their way through the injector, delivered in order of their due time."""

    def __init__(self, injector: Injector, factory: RosbagsFactory) -> None:
        self.injector, self.factory = injector, factory
        self.heap: list[tuple[int, int, str, str, bytes]] = []
        self.order = itertools.count()

    def send(self, topic: str, message: Any, now_ns: int) -> None:
        msgtype = topics.BY_NAME[topic].msgtype
        data = self.factory.serialize(message, msgtype)
        for due_ns, changed in self.injector.take(topic, msgtype, data, now_ns):
            heapq.heappush(self.heap, (due_ns, next(self.order), topic, msgtype, changed))

    def due(self, now_ns: int) -> list[tuple[str, Any]]:
        found = []
        while self.heap and self.heap[0][0] <= now_ns:
            _, _, topic, msgtype, data = heapq.heappop(self.heap)
            found.append((topic, self.factory.deserialize(data, msgtype)))
        return found


def drive_with_faults(
    env: DrivingEnv,
    planner: RawPlanner,
    injector: Injector,
    route: RouteId,
    on_tick: OnTick = lambda tick, gate: None,
    max_ticks: int | None = None,
) -> FaultyDrive:
    """Drive a route to its end, for `max_ticks`, or until the car stands after a stop of the gate."""
    stack = _Stack(env, planner, injector)
    tick, _ = env.reset_to(route)
    start_ns = tick.stamp_ns
    stack.start(start_ns)
    drive = FaultyDrive(result_of(env))
    while not env.done and (max_ticks is None or len(drive.controls) < max_ticks):
        control = stack.drive(tick, with_route=len(drive.controls) % ROUTE_EVERY_TICKS == 0)
        _note(drive, stack, (tick.stamp_ns - start_ns) * 1e-9, env)
        on_tick(tick, stack.gate)
        tick, *_ = env.step(control)
        drive.controls.append(control)
        if drive.stand_s is not None:
            break
    drive.result = result_of(env)
    drive.counts = dict(injector.counts)
    return drive


class _Stack:
    """Planner, gate and the vehicle's command policy, connected as in the ROS graph."""

    def __init__(self, env: DrivingEnv, planner: RawPlanner, injector: Injector) -> None:
        factory, timing, config = RosbagsFactory(), load_timing(), load_gate_config()
        self.planner, self.inputs = planner, PlannerInputs(planner)
        self.messages, self.wire = TickMessages(factory, env.rig), _Wire(injector, factory)
        self.gate = Gate(config.gate_limits(timing), config.motion_limits(), steady=False, simulated=True)
        # Nothing is signed within one process; numbers and the rules of one sender are as in the graph.
        self.gate_inputs = GateInputs(self.gate)
        self.senders = {name: Sender(name) for name in topics.SIGNED}
        self.vehicle = CommandReceiver(CommandPolicy(timing.command_hold_s, timing.command_brake))
        self.braking, self.now_ns = False, 0

    def start(self, now_ns: int) -> None:
        self.wire.injector.start(now_ns)
        self.planner.start(now_ns)
        self.vehicle.place()
        for topic, _, message in self.messages.latched(now_ns):
            self.wire.send(topic, message, now_ns)

    def drive(self, tick: Tick, *, with_route: bool) -> Control:
        """Deliver the messages of this tick; returns the command that the vehicle carries out."""
        now_ns = tick.stamp_ns
        now = Moment(time.monotonic(), now_ns * 1e-9)
        status = self.vehicle.status(now_ns, tick.sensors.odometry.speed_mps, self.senders[topics.STATUS].next())
        self.wire.send(topics.STATUS, status_to_message(self.wire.factory, status), now_ns)
        self.vehicle.ticks += 1
        sources = [self.messages.motion(tick), self.messages.cameras(tick)]
        for topic, _, message in itertools.chain([self.messages.route(tick)] if with_route else [], *sources):
            self.wire.send(topic, message, now_ns)
        self.now_ns = now_ns
        for topic, message in self.wire.due(now_ns):
            if topic == topics.ODOMETRY:
                self.gate_inputs.odometry(message, now)
            elif topic == topics.STATUS:
                self.gate_inputs.status(message, now)
            if topic in self.inputs.handlers:
                decision = self.inputs.receive(topic, message, now_ns)
                if decision is not None:
                    self._send(topics.PROPOSED, decision, now_ns)
            else:
                self._answer(topic, message, now)
        self.planner.look(now_ns)
        for topic, message in self.wire.due(now_ns):
            self._answer(topic, message, now)
        control = self.gate.tick(now)
        if self.gate.state in STOPS:
            self._send(topics.COMMAND, Decision(now_ns, control), now_ns)
        return self._obey(now_ns)

    def _answer(self, topic: str, message: Any, now: Moment) -> None:
        """Deliver a proposal to the gate, or a command to the vehicle."""
        if topic == topics.PROPOSED:
            self._send(topics.COMMAND, self.gate_inputs.proposal(message, now), self.now_ns)
        elif topic == topics.COMMAND:
            self._command(message, self.now_ns)

    def _command(self, message: Any, now_ns: int) -> None:
        decision = self.vehicle.receive(message)
        # Lock-step: a command with another tick's stamp is ignored.
        if decision is not None and decision.stamp_ns == now_ns:
            self.vehicle.policy.accept(decision.control, now_ns)

    def _obey(self, now_ns: int) -> Control:
        for _, message in self.wire.due(now_ns):
            self._command(message, now_ns)
        policy = self.vehicle.policy
        if self.vehicle.stopped:
            self.braking = True
            return self.vehicle.brake()
        if policy.last is not None and policy.last_ns == now_ns:
            self.braking = False
            return policy.last
        self.braking = policy.last is None or policy.expired(now_ns)
        return policy.missing(now_ns)

    def _send(self, topic: str, decision: Decision, now_ns: int) -> None:
        numbered = dataclasses.replace(decision, sequence=self.senders[topic].next())
        self.wire.send(topic, decision_to_message(self.wire.factory, numbered), now_ns)


def _note(drive: FaultyDrive, stack: _Stack, since_s: float, env: DrivingEnv) -> None:
    assert env.world is not None
    gate, known = stack.gate, {cause.split(':')[0] for cause in drive.causes}
    drive.causes += [f.cause for f in stack.planner.findings if f.subject not in known]
    if gate.state not in STOPS and not (stack.braking and drive.controls):
        return
    if drive.stop_s is None:
        reason = gate.reason or stack.vehicle.stopped or 'the vehicle heard no command'
        drive.stop_s, drive.reason = since_s, reason
    drive.stop_state = gate.state.value if gate.state in STOPS else 'vehicle'
    if drive.stand_s is None and abs(env.world.ego.speed) < gate.limits.standing_mps:
        drive.stand_s = since_s
