"""The graph that is attacked, in the hands of an attack: its processes, a stranger's messages, the state of the car."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raw2drive_ros.contracts.errors import GraphError
from raw2drive_ros.graph.processes import Graph, running_graph

if TYPE_CHECKING:
    from raw2drive_ros.nodes.attacker import Stranger, Watcher

# The car has to drive at least so fast before an attack begins.
DRIVES_MPS = 4.0
DRIVE_WITHIN_S = 60.0


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
                # A moment later too: a machine that is too busy for the graph stops the car by itself.
                time.sleep(0.5)
                if abs(self.watcher.speed_mps or 0.0) > DRIVES_MPS:
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
