"""Notes beside the bags of a collection, by which a call that was interrupted is continued by the next one.

One JSON line says what is collected; then one line when a bag is begun and one when it is finished. A bag that was
begun and not finished is driven again from its first episode: episodes depend on their number alone.
"""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

from raw2drive_ros.contracts.errors import BagExistsError
from raw2drive_ros.recording.bag_reader import partial_folder


@dataclass(frozen=True, slots=True)
class FinishedBag:
    """What a bag adds to a collection, and the simulation's clock (ns) at its end."""

    bag: str
    episodes: int
    ticks: int
    clock_ns: int


@contextmanager
def open_journal(folder: Path, first: str, what: dict[str, Any]) -> Iterator[CollectionJournal]:
    """The notes of a collection whose first bag in `folder` has the name `first`, for this process alone.

    what: JSON values that say what is collected. Raises BagExistsError when the bags that are there are those of
    another collection, or while another process collects them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f'.{first}.collection.jsonl').open('a+') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BagExistsError(f'{folder}: another process is collecting these bags') from error
        what = json.loads(json.dumps(what))
        notes = _whole_notes(file)
        if any(_there(folder, note) for note in notes):
            _require_same(folder, notes[0], what)
        if notes[:1] != [what]:
            # The first call, or nothing is left of another collection.
            file.truncate(0)
            notes = [what]
            _write(file, what)
        yield CollectionJournal(folder, file, notes[1:])


class CollectionJournal:
    """notes: of earlier calls, without the first line."""

    def __init__(self, folder: Path, file: TextIO, notes: list[dict[str, Any]]) -> None:
        self.folder, self.file = folder, file
        self.begun = {note['bag'] for note in notes}
        self.finished = {note['bag']: FinishedBag(**note) for note in notes if 'ticks' in note}

    def whole(self, bag: str) -> FinishedBag | None:
        """The note of a bag that is there and finished, or None."""
        return self.finished.get(bag) if (self.folder / bag).is_dir() else None

    def begin(self, bag: str) -> None:
        """Note that a bag is begun, and remove what an interrupted call left of it."""
        if bag in self.begun:
            for path in (self.folder / bag, partial_folder(self.folder / bag)):
                if path.is_dir():
                    shutil.rmtree(path)
        self.begun.add(bag)
        self.finished.pop(bag, None)
        _write(self.file, {'bag': bag})

    def finish(self, done: FinishedBag) -> None:
        """Note that a bag is finished; a note counts only while the bag is there."""
        self.finished[done.bag] = done
        _write(self.file, asdict(done))


def _write(file: TextIO, note: dict[str, Any]) -> None:
    file.write(json.dumps(note) + '\n')
    file.flush()


def _whole_notes(file: TextIO) -> list[dict[str, Any]]:
    """The notes of earlier calls; a line that a killed writer left unfinished is cut off."""
    file.seek(0)
    found, whole = [], 0
    for line in file.read().splitlines(keepends=True):
        try:
            note = json.loads(line)
        except ValueError:
            note = None
        if not isinstance(note, dict) or not line.endswith('\n') or (found and 'bag' not in note):
            break
        found.append(note)
        whole += len(line.encode())
    file.truncate(whole)
    return found


def _there(folder: Path, note: dict[str, Any]) -> bool:
    bag = folder / str(note.get('bag', ''))
    return 'bag' in note and (bag.exists() or partial_folder(bag).exists())


def _require_same(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    different = [
        f'{key} {before.get(key)!r} then, {now.get(key)!r} now'
        for key in before.keys() | now.keys()
        if before.get(key) != now.get(key)
    ]
    if different:
        raise BagExistsError(
            f'{folder}: holds bags of a collection with {"; ".join(sorted(different))}: give another --out or --seed'
        )
