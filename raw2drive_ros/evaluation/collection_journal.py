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
from typing import Any

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.contracts.errors import BagExistsError
from raw2drive_ros.recording.bag_reader import partial_folder


@dataclass(frozen=True, slots=True)
class FinishedBag:
    """What a bag adds to a collection, and the simulation's clock (ns) at its end."""

    bag: str
    episodes: int
    ticks: int
    clock_ns: int


class CollectionJournal:
    """folder, first: where the bags go, and the name of the first one. what: JSON values that say what is collected.

    Raises BagExistsError when bags of another collection with the same first bag are there.
    """

    def __init__(self, folder: Path, first: str, what: dict[str, Any]) -> None:
        self.folder = folder
        self.file = folder / f'.{first}.collection.jsonl'
        self.begun: set[str] = set()
        self.finished: dict[str, FinishedBag] = {}
        what = json.loads(json.dumps(what))
        lines = self._lines()
        if lines and any((folder / str(line.get('bag'))).exists() for line in lines[1:]):
            _require_same(folder, lines[0], what)
            for line in lines[1:]:
                self.begun.add(line['bag'])
                if 'ticks' in line:
                    self.finished[line['bag']] = FinishedBag(**line)
        folder.mkdir(parents=True, exist_ok=True)
        known = [{'bag': bag} for bag in sorted(self.begun)] + [asdict(bag) for bag in self.finished.values()]
        write_whole(self.file, ''.join(json.dumps(line) + '\n' for line in (what, *known)))

    def _lines(self) -> list[dict[str, Any]]:
        """The notes of earlier calls; a line that a killed writer left unfinished ends them."""
        found = []
        if self.file.is_file():
            for text in self.file.read_text(errors='replace').splitlines():
                try:
                    line = json.loads(text)
                except ValueError:
                    break
                if not isinstance(line, dict):
                    break
                found.append(line)
        return found

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Raises BagExistsError while another process collects the same bags."""
        with self.file.open('a') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise BagExistsError(f'{self.folder}: another process is collecting these bags') from error
            yield

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
        self._append({'bag': bag})

    def finish(self, done: FinishedBag) -> None:
        """Note that a bag is finished; a note counts only while the bag is there."""
        self.finished[done.bag] = done
        self._append(asdict(done))

    def _append(self, line: dict[str, Any]) -> None:
        with self.file.open('a') as file:
            file.write(json.dumps(line) + '\n')


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
