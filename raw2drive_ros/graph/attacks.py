"""The attacks of `raw2drive attack`: what a stranger on the wire, a stray process or a dying one can try."""

from __future__ import annotations

import copy
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from raw2drive_ros.contracts import topics

if TYPE_CHECKING:
    from raw2drive_ros.graph.attack_scene import Scene

Make = Callable[['Scene'], Any]


@dataclass(frozen=True, slots=True)
class Attack:
    """One row of the table.

    run: carries the attack out on a car that drives, and returns when it is over. brakes_mps2: the least deceleration
    of the stop that follows. stopped_before: the car is under an emergency stop, and still moving, when `run` begins.
    """

    name: str
    run: Callable[[Scene], None]
    brakes_mps2: float = 3.0
    stopped_before: bool = False


def _flood(topic: str, make: Make, every_s: float = 0.05, seconds: float = 3.0) -> Callable[[Scene], None]:
    """Publish what `make` returns, at intervals of `every_s`; 0: as fast as it goes."""

    def run(scene: Scene) -> None:
        publisher = scene.stranger.publisher(topic)
        scene.begin()
        due = ends = time.monotonic()
        ends += seconds * scene.rng.uniform(0.8, 1.2)
        while time.monotonic() < ends:
            publisher.publish(make(scene))
            due += every_s
            time.sleep(max(0.0, due - time.monotonic()))

    return run


def _once(topic: str, make: Make) -> Callable[[Scene], None]:
    def run(scene: Scene) -> None:
        publisher, message = scene.stranger.publisher(topic), make(scene)
        scene.begin()
        publisher.publish(message)
        time.sleep(2.0)

    return run


def _replay(topic: str, captured: str) -> Callable[[Scene], None]:
    """Publish everything that was captured of one topic on another one, or again on the same."""

    def run(scene: Scene) -> None:
        publisher = scene.stranger.publisher(topic)
        scene.begin()
        for message in list(scene.watcher.captured[captured]):
            publisher.publish(message)
            time.sleep(0.02)

    return run


def full_throttle(scene: Scene) -> Any:
    """An unsigned command or proposal that nobody wants."""
    return scene.control(throttle=1.0, steer=scene.rng.uniform(-0.3, 0.3))


def _forged(scene: Scene) -> Any:
    message = scene.control(throttle=1.0, sequence=1e9)
    message.header.frame_id = f'{scene.rng.bytes(12).hex()}.{scene.rng.bytes(16).hex()}'
    return message


def _absurd(scene: Scene) -> Any:
    return scene.control(throttle=float('nan'), reverse=1e308)


def _huge(scene: Scene) -> Any:
    return scene.control(throttle=1.0, **{f'extra_{i}': 0.0 for i in range(100_000)})


def _twice(scene: Scene) -> Any:
    message = scene.control(throttle=0.0)
    message.name = [*message.name, 'throttle']
    message.position = [*message.position, 1.0]
    return message


def _altered(topic: str, **values: float) -> Make:
    def make(scene: Scene) -> Any:
        from raw2drive_ros.nodes.attacker import changed

        return changed(scene.watcher.captured[topic][-1], list(values), list(values.values()))

    return make


def _other_key(scene: Scene) -> Any:
    from msg_adapters.signatures import sign

    message = scene.control(throttle=1.0, sequence=float(scene.count()))
    return sign(message, topics.COMMAND, bytes(32), 'f' * 24)


def _odometry(speed_mps: float) -> Make:
    def make(scene: Scene) -> Any:
        message = copy.deepcopy(scene.watcher.captured[topics.ODOMETRY][-1])
        message.twist.twist.linear.x = speed_mps
        return scene.stamped(message)

    return make


def _clock(ahead_s: float) -> Make:
    def make(scene: Scene) -> Any:
        from rosgraph_msgs.msg import Clock

        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(round((scene.watcher.stamp_s + ahead_s) * 1e9), 10**9)
        return message

    return make


def _driver_drives(scene: Scene) -> Any:
    from std_msgs.msg import Bool

    return Bool(data=False)


def _calls(service: str) -> Callable[[Scene], None]:
    """Call a service of the gate again and again while the car still moves."""

    def run(scene: Scene) -> None:
        while abs(scene.watcher.speed_mps or 0.0) > 1.0:
            scene.trigger(service)
            time.sleep(0.05)

    return run


def _lie_and_activate(scene: Scene) -> None:
    publisher, make = scene.stranger.publisher(topics.ODOMETRY), _odometry(0.0)
    scene.begin()
    # Not until it stands: then whoever calls may activate it.
    while abs(scene.watcher.speed_mps or 0.0) > 1.0:
        for _ in range(3):
            publisher.publish(make(scene))
        scene.trigger('/safety_gate/activate')


def _kill_gate(scene: Scene) -> None:
    scene.restart('safety_gate', signal.SIGKILL)
    time.sleep(6.0)


def _kill_planner(scene: Scene) -> None:
    """A new planner beside the dead one's lease; whoever activates meanwhile may not make it start by itself later."""
    scene.restart('planner', signal.SIGKILL)
    for _ in range(30):
        time.sleep(0.2)
        scene.trigger('/safety_gate/activate')
        if abs(scene.watcher.speed_mps or 0.0) < 0.3:
            break
    time.sleep(2.0)


def _freeze(name: str, seconds: float) -> Callable[[Scene], None]:
    def run(scene: Scene) -> None:
        process = scene.graph.processes[name]
        scene.begin()
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)
        time.sleep(1.0)

    return run


def _second(node: str) -> Callable[[Scene], None]:
    """A second process of ours, which has the key: started twice by mistake."""

    def run(scene: Scene) -> None:
        scene.start(node, f'second_{node}')
        deadline = time.monotonic() + 25.0
        log = scene.graph.folder / f'second_{node}.log'
        while time.monotonic() < deadline and not log.stat().st_size:
            # Its first line comes before its first message.
            time.sleep(0.01)
        scene.begin()
        while time.monotonic() < deadline and abs(scene.watcher.speed_mps or 0.0) > 0.3:
            time.sleep(0.1)
        time.sleep(1.0)
        scene.end(f'second_{node}')

    return run


def _real_clock(scene: Scene) -> None:
    scene.set_parameter('/safety_gate', 'use_sim_time', value=False)
    time.sleep(3.0)
    scene.set_parameter('/safety_gate', 'use_sim_time', value=True)


def attacks() -> Iterator[Attack]:
    """All of them, in the order of the table."""
    command, proposed, status, odometry = topics.COMMAND, topics.PROPOSED, topics.STATUS, topics.ODOMETRY
    yield Attack('commands: full throttle at 20 Hz', _flood(command, full_throttle))
    yield Attack('commands: full throttle at 300 Hz', _flood(command, full_throttle, 1 / 300))
    yield Attack('commands: a single one', _once(command, full_throttle))
    yield Attack('commands: with an invented signature', _flood(command, _forged))
    yield Attack('commands: signed with another key', _flood(command, _other_key))
    yield Attack('commands: captured and changed', _flood(command, _altered(command, throttle=1.0, brake=0.0)))
    yield Attack('commands: captured and replayed', _replay(command, command))
    yield Attack('commands: captured proposals', _replay(command, proposed))
    yield Attack('commands: NaN and absurd values', _once(command, _absurd))
    yield Attack('commands: 100,000 values', _once(command, _huge))
    yield Attack('proposals: full throttle at 20 Hz', _flood(proposed, full_throttle))
    yield Attack('proposals: as fast as it goes', _flood(proposed, full_throttle, 0.0))
    yield Attack('proposals: a single one', _once(proposed, full_throttle))
    yield Attack('proposals: one name twice', _once(proposed, _twice))
    yield Attack('proposals: captured and changed', _flood(proposed, _altered(proposed, throttle=1.0)))
    yield Attack('proposals: captured and replayed', _replay(proposed, proposed))
    yield Attack('odometry: standing, at 100 Hz', _flood(odometry, _odometry(0.0), 0.01))
    yield Attack('odometry: a single sample of 40 m/s', _once(odometry, _odometry(40.0)))
    yield Attack('odometry: standing, and activate', _lie_and_activate, stopped_before=True)
    yield Attack('status: not stopped, unsigned', _flood(status, lambda scene: scene.status(speed_mps=0.0)))
    yield Attack('status: captured and replayed', _replay(status, status))
    yield Attack(
        'status: put elsewhere, under a stop', _flood(status, _altered(status, ticks=0.0)), stopped_before=True
    )
    yield Attack('clock: 100 s ahead', _flood(topics.CLOCK, _clock(100.0)))
    yield Attack('clock: 5 s back', _flood(topics.CLOCK, _clock(-5.0)))
    yield Attack('clock: 2 s ahead, once', _once(topics.CLOCK, _clock(2.0)))
    yield Attack('gate: start_over under a stop', _calls('/safety_gate/start_over'), stopped_before=True)
    yield Attack('gate: activate under a stop', _calls('/safety_gate/activate'), stopped_before=True)
    yield Attack('gate: killed and started again under a stop', _kill_gate, stopped_before=True)
    yield Attack('gate: killed and started again while driving', _kill_gate)
    yield Attack('gate: started a second time', _second('safety_gate'))
    yield Attack('gate: its clock switched to system time', _real_clock)
    yield Attack('gate: halted for 2 s (SIGSTOP)', _freeze('safety_gate', 2.0))
    yield Attack('planner: killed and started again, activate', _kill_planner, brakes_mps2=1.0)
    yield Attack('planner: started a second time', _second('planner'))
    yield Attack('planner: halted for 2 s (SIGSTOP)', _freeze('planner', 2.0), brakes_mps2=1.0)
    yield Attack('autonomy: the driver has taken over', _once(topics.AUTONOMY, _driver_drives), brakes_mps2=0.7)
