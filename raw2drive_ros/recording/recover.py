"""Makes a bag from what a killed recorder left, or from a damaged file: everything that can still be read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml
from rosbags.interfaces import MessageDefinition

from raw2drive_ros.bounds import MAX_MESSAGE_BYTES, Allowance, TooLargeError, read_json, require_regular
from raw2drive_ros.contracts.errors import BagError, UserError
from raw2drive_ros.recording.bag_edit import whole_bag
from raw2drive_ros.recording.bag_reader import partial_folder, said
from raw2drive_ros.recording.bag_writer import PROVENANCE
from raw2drive_ros.recording.bounded_bag import METADATA, open_storage, read_metadata
from raw2drive_ros.recording.bounded_mcap import FORMATS, UNTYPED
from raw2drive_ros.recording.copying import Account, Copier, verify
from raw2drive_ros.recording.losses import Losses
from raw2drive_ros.recording.salvage import Gap, open_salvage
from raw2drive_ros.recording.stamped_mcap import holds_stamps
from raw2drive_ros.recording.unpack import ZSTD_MAGIC, unpack_file, unpacked_message

STORAGE_FILES = ('*.mcap', '*.mcap.zstd', '*.db3', '*.db3.zstd')


@dataclass(slots=True)
class Recovery:
    """bag: what was made. counts: messages per topic in it. damaged: chunks that could not be read. breaks: places
    where the boundaries of records were lost. strange: records of unknown kinds. skipped_bytes: that are no whole
    records. truncated: a file ends in the middle, as after a kill. account: topics and messages that were left out.
    lost_s: seconds that are missing, per topic. lost_messages: of damaged chunks, per topic, where their index has
    survived."""

    bag: Path
    counts: dict[str, int] = field(default_factory=dict)
    damaged: int = 0
    breaks: int = 0
    strange: int = 0
    skipped_bytes: int = 0
    truncated: bool = False
    account: Account = field(default_factory=Account)
    lost_s: dict[str, float] = field(default_factory=dict)
    lost_messages: Counter[str] = field(default_factory=Counter)

    @property
    def skipped(self) -> dict[str, str]:
        """Topics whose type cannot be used, with the reason."""
        return self.account.topics

    def lines(self) -> list[str]:
        """What was left out or lost, a line each."""
        found = self.account.lines()
        if self.damaged:
            found.append(f'{self.damaged} damaged chunks left out')
        if self.breaks:
            found.append(f'{self.breaks} places where records could not be told apart; reading went on behind them')
        if self.strange:
            found.append(f'{self.strange} records of unknown kinds left out')
        if self.skipped_bytes:
            found.append(f'{self.skipped_bytes} bytes are no whole records')
        if self.truncated:
            found.append('the file ends in the middle of a record, as after a kill')
        for topic in sorted(self.lost_s.keys() | self.lost_messages.keys()):
            seconds = f'{self.lost_s[topic]:.2f} s' if topic in self.lost_s else ''
            count = f'{self.lost_messages[topic]} messages' if topic in self.lost_messages else ''
            found.append(f'lost of {topic}: {", ".join(filter(None, (seconds, count)))}')
        return found


def find_files(path: Path) -> list[Path]:
    """The storage files of a bag, of a `.NAME.partial` folder, or of that folder of a bag NAME that was never finished.

    Raises BagError.
    """
    if not path.is_dir() and path.exists():
        return [path]
    folder = path if path.is_dir() else partial_folder(path)
    found: list[Path] = []
    for search in (folder.glob, folder.rglob) if folder.is_dir() else ():
        found = found or [file for pattern in STORAGE_FILES for file in search(pattern)]
    if not found:
        raise BagError(f'{path}: no MCAP file there, and no SQLite database, nor in {folder.name}')
    bags = sorted({str(file.parent.relative_to(folder)) for file in found})
    if len(bags) > 1:
        raise BagError(f'{path}: holds several bags, give one of them: {", ".join(bags)}')
    return sorted(found, key=_numbered)


def _numbered(file: Path) -> list[tuple[int, str]]:
    """Part 10 comes after part 9."""
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in re.split(r'(\d+)', file.name)]


def recover(path: Path, out: Path) -> Recovery:
    """Write a new, complete bag from an unfinished or damaged one, and verify it by reading it again.

    Every message in it has been decoded. Raises BagError when nothing can be read, BagExistsError or DiskFullError.
    """
    files = find_files(path)
    found = Recovery(out)
    metadata = _provenance(files[0]) | {'recovered_from': path.name}
    losses = Losses()
    with whole_bag(out, metadata) as bag:
        copier = Copier(bag, found.account)
        for file in files:
            try:
                _copy(file, copier, found, losses)
            except (OSError, ValueError) as error:
                raise BagError(f'{file}: cannot be recovered: {said(error)}') from error
        if not bag.counts:
            left = '; '.join(found.lines())
            raise BagError(f'{path}: not a single message can be read' + (f'; {left}' if left else ''))
    verify(out, copier)
    found.counts = dict(found.account.counts)
    found.lost_s = losses.seconds()
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
            return {str(k): str(v) for k, v in read_json(folder / PROVENANCE).items()}
        if (folder / METADATA).is_file():
            custom = read_metadata(folder).get('custom_data') or {}
            return {str(k): str(v) for k, v in custom.items()}
    return {}


def _copy(file: Path, copier: Copier, found: Recovery, losses: Losses) -> None:
    """Raises OSError for what is no regular file, ValueError for what exceeds a limit."""
    kind = file.suffixes[-2:][0] if file.suffix == '.zstd' else file.suffix
    into = _Target(copier, losses, Allowance(require_regular(file)))
    with ExitStack() as stack:
        if kind == '.db3':
            _copy_database(file, stack, into, found)
        else:
            _copy_mcap(stack.enter_context(_plain(file)), into, found)


@contextmanager
def _plain(file: Path) -> Iterator[Path]:
    """The file, unpacked into a temporary folder where it was compressed as a whole."""
    if file.suffix != '.zstd':
        yield file
        return
    with TemporaryDirectory() as folder:
        target = Path(folder) / file.stem
        unpack_file(file, target, Allowance(require_regular(file)))
        yield target


@dataclass(frozen=True, slots=True)
class _Target:
    """Where messages of one file go. allowance: of the messages that were compressed one by one."""

    copier: Copier
    losses: Losses
    allowance: Allowance

    def write(
        self,
        topic: str,
        stamp_ns: int,
        data: bytes,
        msgtype: str,
        definition: MessageDefinition,
        received_ns: int | None = None,
    ) -> None:
        """received_ns: see `BagWriter.write_raw`. Raises TooLargeError where the messages of the file unpack to
        implausibly much."""
        content = data
        # No message begins like this: its first bytes are the encapsulation header 0 0, 0 1 and so on.
        if data.startswith(ZSTD_MAGIC):
            try:
                content = unpacked_message(data)
            except ValueError as error:
                # It cost at most what the largest message costs.
                self.allowance.spend(MAX_MESSAGE_BYTES if isinstance(error, TooLargeError) else 0)
                self.copier.account.refuse(topic, f'compressed, and {error}')
                return
            self.allowance.spend(len(content))
        if self.copier.write(topic, stamp_ns, content, msgtype, definition, received_ns):
            self.losses.message(topic, stamp_ns)


def _copy_mcap(file: Path, into: _Target, found: Recovery) -> None:
    salvage = open_salvage(file)
    stamped = holds_stamps(file)
    for item in salvage.records():
        if isinstance(item, Gap):
            into.losses.damaged(item.end_ns)
            continue
        known = salvage.definition(item.channel)
        if known is None:
            found.account.refuse('unknown topics', 'their definition is lost')
            continue
        channel, schema = known
        form = FORMATS.get(schema.encoding)
        definition = MessageDefinition(form, schema.data.decode(errors='replace')) if form else UNTYPED
        stamp_ns, received_ns = (item.publish_ns, item.log_ns) if stamped else (item.log_ns, None)
        into.write(channel.topic, stamp_ns, item.data, schema.name, definition, received_ns)
    found.damaged += salvage.damaged
    found.breaks += salvage.breaks
    found.strange += salvage.strange
    found.skipped_bytes += salvage.skipped_bytes
    found.truncated |= salvage.truncated
    for number, count in salvage.lost.items():
        known = salvage.definition(number)
        found.lost_messages[known[0].topic if known else 'unknown topics'] += count


def _copy_database(file: Path, stack: ExitStack, into: _Target, found: Recovery) -> None:
    try:
        storage = open_storage(file, stack)
        for connection, stamp_ns, data in storage.messages(storage.connections):
            into.write(connection.topic, stamp_ns, data, connection.msgtype, connection.msgdef)
    except (OSError, TooLargeError, UserError):
        raise
    except Exception:
        # Damaged databases raise all kinds of errors; what came before is saved.
        found.truncated = True
        into.losses.damaged()
