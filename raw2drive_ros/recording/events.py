"""What happened in a bag: each change in the diagnostics of the nodes, and each beginning of an episode."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import transition_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.recording.bag_reader import begin_ns, decoded, messages_in, open_bag
from raw2drive_ros.recording.line_reader import time_lines

LEVELS = ('ok', 'warning', 'error', 'stale')
FIGURES = re.compile(r'[-+]?\d+(\.\d+)?(e[-+]?\d+)?')


@dataclass(frozen=True, slots=True)
class Event:
    """time_s: after the bag's beginning. level: one of LEVELS."""

    time_s: float
    node: str
    level: str
    text: str


def events_of(path: Path) -> list[Event]:
    """In order of time. A status that differs from the one before in its figures only is no event. Raises BagError.

    Where time goes back in the bag, that is an event, and the next drive's times follow those of the one before.
    """
    factory = RosbagsFactory()
    found: list[Event] = []
    last: dict[str, tuple[int, str]] = {}
    with open_bag(path) as reader:
        passed_s = 0.0
        for number, line in enumerate(time_lines(reader)):
            begins_ns, begun_ns = begin_ns(line), -1
            if number:
                found.append(Event(passed_s, 'recorder', 'warning', 'time went back: another drive begins'))
            wanted = [c for c in line.connections if c.topic in (topics.DIAGNOSTICS, topics.TRANSITION)]
            for connection, stamp_ns, data in messages_in(line, connections=wanted) if wanted else ():
                time_s = passed_s + (stamp_ns - begins_ns) * 1e-9
                try:
                    message = decoded(factory, reader, connection, data)
                    if connection.topic == topics.TRANSITION:
                        step, episode = transition_from_message(message)
                        # A first tick that the bridge resent is not a second beginning.
                        if step.is_first and stamp_ns != begun_ns:
                            begun_ns = stamp_ns
                            found.append(Event(time_s, 'bridge', 'ok', f'{episode} begins'))
                        continue
                    statuses = diagnostics_from_message(message)
                except (ContractError, BagError) as error:
                    found.append(Event(time_s, 'bag', 'warning', f'{connection.topic} refused: {error}'))
                    continue
                found += _changes(statuses, time_s, last)
            passed_s += (line.end_time - begins_ns) * 1e-9
    return found


def _changes(
    statuses: list[tuple[str, int, str, dict[str, str]]], time_s: float, last: dict[str, tuple[int, str]]
) -> list[Event]:
    """What the statuses of one message say anew; `last`: by node, what it said before."""
    found = []
    for name, level, text, _ in statuses:
        said = level, FIGURES.sub('', text)
        if last.get(name) != said:
            last[name] = said
            shown = LEVELS[min(level, len(LEVELS) - 1)]
            found.append(Event(time_s, name.removeprefix('raw2drive: '), shown, text))
    return found
