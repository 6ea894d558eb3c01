"""Does metadata.yaml say what the storage holds? For `raw2drive bag doctor`."""

from __future__ import annotations

from pathlib import Path

import yaml

from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_reader import bag_folder, open_bag
from raw2drive_ros.recording.bounded_bag import read_metadata


def metadata_against_storage(path: Path) -> list[str]:
    """What metadata.yaml promises and the storage files do not hold, a line for each topic. Readers here go by the
    storage; other tools may go by metadata.yaml. Raises BagError."""
    try:
        rows = read_metadata(bag_folder(path)).get('topics_with_message_count') or []
        promised = {(str(row['topic_metadata']['name']), str(row['topic_metadata']['type'])): row for row in rows}
        counts = {key: int(row['message_count']) for key, row in promised.items()}
    except (OSError, yaml.YAMLError, ValueError, TypeError, KeyError) as error:
        raise BagError(f'{path}: damaged metadata.yaml: {error}') from error
    with open_bag(path) as reader:
        stored = {(c.topic, c.msgtype): c.msgcount for c in reader.connections}
    keys = sorted(counts.keys() | stored.keys())
    return [
        f'metadata.yaml promises {counts.get(key, 0)} messages of {key[0]}, and there are {stored.get(key, 0)}'
        for key in keys
        if counts.get(key, 0) != stored.get(key, 0)
    ]
