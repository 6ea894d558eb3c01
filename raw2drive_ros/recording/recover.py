"""Makes a bag from what a killed recorder left, or from a damaged file: everything that can still be read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.typesys import TypesysError

from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_edit import whole_bag
from raw2drive_ros.recording.bag_reader import messages_in, open_bag, partial_folder
from raw2drive_ros.recording.bag_writer import PROVENANCE, BagWriter
from raw2drive_ros.recording.stamped_mcap import holds_stamps


@dataclass(slots=True)
class Recovery:
    """bag: what was made. counts: messages per topic in it. damaged: chunks that could not be read. truncated: the file
    ends in the middle of a record, as after a kill. skipped: topics whose type cannot be used, with the reason."""

    bag: Path
    counts: dict[str, int] = field(default_factory=dict)
    damaged: int = 0
    truncated: bool = False
    skipped: dict[str, str] = field(default_factory=dict)


def find_mcap(path: Path) -> list[Path]:
    """The MCAP files of a bag, of a `.NAME.partial` folder, or of that folder of a bag NAME that was never finished."""
    if path.is_file():
        return [path]
    folder = path if path.is_dir() else partial_folder(path)
    found = (sorted(folder.glob('*.mcap')) or sorted(folder.rglob('*.mcap'))) if folder.is_dir() else []
    if not found:
        raise BagError(f'{path}: no MCAP file there, nor in {folder.name}')
    bags = sorted({str(file.parent.relative_to(folder)) for file in found})
    if len(bags) > 1:
        raise BagError(f'{path}: holds several bags, give one of them: {", ".join(bags)}')
    return found


def recover(path: Path, out: Path) -> Recovery:
    """Write a new, complete bag from an unfinished or damaged one, and verify it by reading it again.

    Raises BagError when nothing can be read, BagExistsError or DiskFullError.
    """
    files = find_mcap(path)
    found = Recovery(out)
    metadata = _provenance(files[0]) | {'recovered_from': path.name}
    with whole_bag(out, metadata) as bag:
        for file in files:
            _copy(file, bag, found)
        if not bag.counts:
            raise BagError(f'{path}: not a single message can be read')
    found.counts = dict(bag.counts)
    written = _count(out)
    if written != found.counts:
        raise BagError(f'{out}: recovered {found.counts}, but reading it again gives {written}')
    return found


def _provenance(file: Path) -> dict[str, str]:
    """Provenance beside the file; a damaged one is no reason to lose the messages."""
    try:
        return _read_provenance(file)
    except (OSError, ValueError, AttributeError, TypeError, yaml.YAMLError):
        return {'provenance': 'damaged'}


def _read_provenance(file: Path) -> dict[str, str]:
    for folder in (file.parent, file.parent.parent):
        if (folder / PROVENANCE).is_file():
            return {k: str(v) for k, v in json.loads((folder / PROVENANCE).read_text()).items()}
        if (folder / 'metadata.yaml').is_file():
            loaded = yaml.safe_load((folder / 'metadata.yaml').read_text()) or {}
            return dict((loaded.get('rosbag2_bagfile_information') or {}).get('custom_data') or {})
    return {}


def _count(bag: Path) -> dict[str, int]:
    counts: dict[str, int] = {}
    with open_bag(bag) as reader:
        for connection, _, _ in messages_in(reader):
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    return counts


def _copy(file: Path, bag: BagWriter, found: Recovery) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    stamped = holds_stamps(file)
    for record in _records(file, found):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message) and record.channel_id in channels:
            channel = channels[record.channel_id]
            if channel.topic in found.skipped:
                continue
            try:
                schema = schemas[channel.schema_id]
                foreign = schema.name, schema.data.decode()
                stamp_ns, received_ns = (record.publish_time, record.log_time) if stamped else (record.log_time, None)
                bag.write_raw(channel.topic, stamp_ns, record.data, foreign, received_ns)
            except (KeyError, ValueError, SyntaxError, TypesysError) as error:
                found.skipped[channel.topic] = f'{type(error).__name__}: {error}'


def _records(file: Path, found: Recovery) -> Iterator[Any]:
    """Records in the order in which they were written, chunk by chunk; what cannot be read is counted."""
    with file.open('rb') as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inner = breakup_chunk(record, validate_crc=True)
                except Exception:
                    # Every decompressor raises other errors; none of them may stop the recovery of the other chunks.
                    found.damaged += 1
                    continue
                yield from inner
        except Exception:
            # A killed writer leaves half a record at the end, and damage may give any length (MemoryError); nothing
            # can be parsed after it.
            found.truncated = True
