"""Attacks a real graph on this machine and measures what the car does: largest speed afterwards, time to stand, log."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raw2drive_ros.contracts.errors import GraphError
from raw2drive_ros.graph.attacks import Attack, full_throttle
from raw2drive_ros.graph.processes import Graph, running_graph

if TYPE_CHECKING:
    from raw2drive_ros.nodes.attacker import Stranger, Watcher

# The car has to drive at least so fast before an attack begins.
DRIVES_MPS, STANDS_MPS = 4.0, 0.3
# From the first message or signal until the brakes are on; what the brakes then need is `Attack.brakes_mps2`.
REACTION_S = 1.5
DRIVE_WITHIN_S, STAND_WITHIN_S = 60.0, 15.0
# How long a car that stands is watched: nothing may make it start again by itself.
WATCHED_S = 3.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """One row of the table; times in seconds from the first message or signal of the attack.

    before_mps: speed when the first message or signal was sent. largest_mps: the largest speed from then on. stand_s:
    when the car stood, None: never. allowed_s: when it has to. moved_again: whether it started again before anybody
    activated. logged: first line of gate, vehicle or planner that says so, '' if nobody did.
    """

    attack: str
    before_mps: float
    largest_mps: float
    stand_s: float | None
    allowed_s: float
    moved_again: bool
    logged: str

    @property
    def passed(self) -> bool:
        stood = self.stand_s is not None and self.stand_s <= self.allowed_s
        return stood and not self.moved_again and bool(self.logged)


class Scene:
    """A graph whose car drives by the raw policy in real time, with a watcher and a stranger in it."""

    def __init__(self, graph: Graph, watcher: Watcher, bundle: Path, seed: int, domain: int) -> None:
        self.graph, self.watcher, self.bundle, self.domain = graph, watcher, bundle, domain
        self.rng = np.random.default_rng(seed)
        self.stranger: Stranger
        self.numbers = itertools.count(1_000_000)
        self.read: dict[str, int] = {}
        self.begun: tuple[float, float] | None = None

    def begin(self) -> None:
        """The attack begins now: called before its first message or signal, later calls change nothing."""
        if self.begun is None:
            self.begun = time.monotonic(), abs(self.watcher.speed_mps or 0.0)

    # -- processes ------------------------------------------------------------------------------------

    def start(self, node: str, name: str = '') -> None:
        parameters: dict[str, dict[str, Any]] = {
            'safety_gate': {'clock': 'steady', 'simulated': True},
            'planner': {'bundle': str(self.bundle)},
            'bridge': {
                'scenario': 'LaneFollowing',
                'lock_step': False,
                'bev': False,
                'seed': int(self.rng.integers(1000)),
            },
        }
        self.graph.start(name or node, parameters[node], sim_time=node != 'bridge', node=node)

    def end(self, name: str) -> None:
        process = self.graph.processes.pop(name)
        process.kill()
        process.wait()

    def restart(self, name: str, number: int) -> None:
        process = self.graph.processes[name]
        self.begin()
        process.send_signal(number)
        process.wait()
        # Its log begins anew.
        self.read.pop(f'{name}.log', None)
        self.start(name)

    # -- what a stranger can send -----------------------------------------------------------------------

    def count(self) -> int:
        return next(self.numbers)

    def control(self, **values: float) -> Any:
        """An unsigned JointState with these actuators, all others 0, stamped with the simulation's time."""
        from sensor_msgs.msg import JointState

        named = {'throttle': 0.0, 'brake': 0.0, 'steer': 0.0, 'reverse': 0.0, 'action': -1.0} | values
        return self.stamped(JointState(name=list(named), position=list(named.values())))

    def status(self, **values: float) -> Any:
        from sensor_msgs.msg import JointState

        named = {'stopped': 0.0, 'activation': 1e6, 'placed': 1e15, 'ticks': 0.0, 'sequence': 1e6} | values
        return self.stamped(JointState(name=list(named), position=list(named.values())))

    def stamped(self, message: Any) -> Any:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(round(self.watcher.stamp_s * 1e9), 10**9)
        return message

    def trigger(self, service: str) -> bool:
        from std_srvs.srv import Trigger

        self.begin()
        answer = self.watcher.call(service, Trigger)
        return answer is not None and bool(answer.success)

    def set_parameter(self, node: str, name: str, *, value: bool) -> None:
        from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
        from rcl_interfaces.srv import SetParameters

        boxed = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=boxed)])
        self.begin()
        self.watcher.call(f'{node}/set_parameters', SetParameters, request)

    # -- states of the car --------------------------------------------------------------------------------

    def wait(self, fast: Callable[[float], bool], seconds: float) -> bool:
        """Whether the speed fulfils `fast` within so many seconds."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self.watcher.speed_mps is not None and fast(abs(self.watcher.speed_mps)):
                return True
            time.sleep(0.02)
        return False

    def drive(self) -> None:
        """Activate the gate until the car drives. Raises GraphError when it does not."""
        deadline = time.monotonic() + DRIVE_WITHIN_S
        while time.monotonic() < deadline:
            self.graph.check()
            if self.wait(lambda speed: speed > DRIVES_MPS, 2.0):
                return
            self.trigger('/safety_gate/activate')
        raise GraphError(f'the car did not drive within {DRIVE_WITHIN_S:.0f} s: {self.graph.last_words("safety_gate")}')

    def new_lines(self) -> list[str]:
        """Warnings and errors that the nodes have logged since the last call."""
        found = []
        for path in sorted(self.graph.folder.glob('*.log')):
            data = path.read_bytes()
            new, self.read[path.name] = data[self.read.get(path.name, 0) :], len(data)
            lines = new.decode(errors='replace').splitlines()
            found += [f'{path.stem}: {_text(line)}' for line in lines if '[WARN]' in line or '[ERROR]' in line]
        return found


def _text(line: str) -> str:
    """A line of rclpy's log without level, time and node."""
    return line.rpartition(']: ')[2] if ']: ' in line else line


@contextmanager
def scene(folder: Path, domain: int, bundle: Path, seed: int) -> Iterator[Scene]:
    """Start bridge, planner and gate, and end them again."""
    from raw2drive_ros.nodes.attacker import Watcher
    from raw2drive_ros.nodes.transport import configure_transport

    configure_transport()
    with running_graph(folder, domain) as graph, Watcher(domain) as watcher:
        made = Scene(graph, watcher, bundle, seed, domain)
        for node in ('safety_gate', 'planner', 'bridge'):
            made.start(node)
        yield made


def carry_out(at: Scene, attack: Attack) -> Outcome:
    """One attack on a car that drives. Raises GraphError when the car does not drive beforehand."""
    from raw2drive_ros.contracts import topics
    from raw2drive_ros.nodes.attacker import Stranger

    at.drive()
    time.sleep(at.rng.uniform(0.0, 0.5))
    at.new_lines()
    with Stranger(at.domain) as stranger:
        at.stranger = stranger
        if attack.stopped_before:
            stranger.publisher(topics.COMMAND).publish(full_throttle(at))
            time.sleep(0.3)
            at.new_lines()
        at.begun = None
        attack.run(at)
        at.begin()
        at.wait(lambda speed: speed < STANDS_MPS, STAND_WITHIN_S)
    time.sleep(WATCHED_S)
    assert at.begun is not None
    started, before = at.begun
    seen = at.watcher.since(started)
    stand_s = next((since for since, speed in seen if abs(speed) < STANDS_MPS), None)
    largest = max((abs(speed) for _, speed in seen), default=0.0)
    again = stand_s is not None and any(abs(speed) > 2 * STANDS_MPS for since, speed in seen if since > stand_s)
    lines = at.new_lines()
    allowed = REACTION_S + largest / attack.brakes_mps2
    return Outcome(attack.name, before, largest, stand_s, allowed, again, lines[0] if lines else '')


def run_attacks(
    folder: Path, domain: int, bundle: Path, chosen: Sequence[Attack], seed: int, on_outcome: Callable[[Outcome], None]
) -> list[Outcome]:
    """Carry the attacks out one after another, on a new graph where the last one has left none that drives."""
    found: list[Outcome] = []
    left = list(chosen)
    for number in itertools.count():
        if not left:
            return found
        with scene(folder / f'graph_{number}', domain, bundle, seed + number) as at:
            done = 0
            try:
                for attack in left:
                    outcome = carry_out(at, attack)
                    found.append(outcome)
                    on_outcome(outcome)
                    done += 1
            except GraphError:
                if not done:
                    raise
        left = left[done:]
    raise AssertionError
