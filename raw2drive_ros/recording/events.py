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
    """In order of time. A status that differs from the one before in its figures only is no event. Raises BagError."""
    factory = RosbagsFactory()
    found: list[Event] = []
    last: dict[str, tuple[int, str]] = {}
    with open_bag(path) as reader:
        begins_ns, begun_ns = begin_ns(reader), -1
        wanted = [c for c in reader.connections if c.topic in (topics.DIAGNOSTICS, topics.TRANSITION)]
        for connection, stamp_ns, data in messages_in(reader, connections=wanted) if wanted else ():
            time_s = (stamp_ns - begins_ns) * 1e-9
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
            for name, level, text, _ in statuses:
                said = level, FIGURES.sub('', text)
                if last.get(name) != said:
                    last[name] = said
                    shown = LEVELS[min(level, len(LEVELS) - 1)]
                    found.append(Event(time_s, name.removeprefix('raw2drive: '), shown, text))
    return found
