"""A bag's content in numbers: topics, rates, gaps, episodes, provenance."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import yaml

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import transition_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.recording.bag_reader import bag_folder, begin_ns, decoded, messages_in, open_bag
from raw2drive_ros.recording.bounded_bag import read_metadata


def bag_info(path: Path) -> dict[str, Any]:
    """Reads every message's stamp once. refused: transitions that break their contract, and are left out. Raises
    BagError."""
    factory = RosbagsFactory()
    stamps: dict[str, list[int]] = {}
    episodes: list[str] = []
    refused: list[str] = []
    begun = -1
    transition_type = topics.BY_NAME[topics.TRANSITION].msgtype
    with open_bag(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        for connection, stamp, data in messages_in(reader, any_type=True):
            stamps.setdefault(connection.topic, []).append(stamp)
            if connection.topic == topics.TRANSITION and connection.msgtype == transition_type:
                try:
                    step, episode = transition_from_message(decoded(factory, reader, connection, data))
                except (ContractError, BagError) as error:
                    refused.append(f'{topics.TRANSITION} at {stamp} ns: {error}')
                    continue
                # A first tick that the bridge resent is not a second beginning.
                if step.is_first and stamp != begun:
                    begun = stamp
                    episodes.append(episode)
        rows = []
        for topic in sorted(types):
            times = sorted(stamps.get(topic, []))
            gaps = [b - a for a, b in itertools.pairwise(times)]
            span = (times[-1] - times[0]) * 1e-9 if len(times) > 1 else 0.0
            rows.append(
                {
                    'topic': topic,
                    'type': types[topic],
                    'messages': len(times),
                    'rate_hz': (len(times) - 1) / span if span else 0.0,
                    'largest_gap_s': max(gaps, default=0) * 1e-9,
                }
            )
        everything = [t for times in stamps.values() for t in times]
        # As in `bag cut` and `replay`: from the first message that is not latched.
        duration = (max(everything) - begin_ns(reader)) * 1e-9 if everything else 0.0
        custom = provenance_of(path)
    return {
        'path': str(path),
        'duration_s': duration,
        'messages': len(everything),
        'bytes': sum(f.stat().st_size for f in bag_folder(path).iterdir()),
        'provenance': custom,
        'topics': rows,
        'episodes': episodes,
        'refused': refused,
    }


def provenance_of(path: Path) -> dict[str, str]:
    """The provenance that the writer put into metadata.yaml. Raises BagError."""
    file = bag_folder(path) / 'metadata.yaml'
    try:
        found = dict(read_metadata(file.parent).get('custom_data') or {})
    except (OSError, yaml.YAMLError, ValueError, TypeError) as error:
        raise BagError(f'{file}: damaged: {error}') from error
    return {str(key): str(value) for key, value in found.items()}
