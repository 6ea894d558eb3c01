"""How a scene's parameters are drawn: by name, from a seed, within the part of the parameter space that a split owns.

Training, validation and evaluation differ in more than seeds. Every scenario type names its *key* parameters: the
layout of the road, where the event happens, how fast and how close. Their ranges are divided into `BINS` bins each; a
combination of bins is a cell, and a hash of type and cell says which split owns it. A scene is drawn again until its
cell belongs to the split of its seed. Values keep away from the borders of their bins, so that two scenes of different
splits differ in some key parameter by at least `GAP` of its range.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

Rng = np.random.Generator
T = TypeVar('T')

EVALUATION, VALIDATION, TRAINING = 'evaluation', 'validation', 'training'
# Seeds of evaluation begin at 0.
VALIDATION_SEED_START, TRAIN_SEED_START = 50_000, 100_000
BINS = 4
# Share of a bin that is left free at either of its ends.
MARGIN = 0.1
GAP = 2.0 * MARGIN / BINS
# Of ten cells, how many belong to evaluation and to validation; the others belong to training.
EVALUATION_CELLS, VALIDATION_CELLS, ALL_CELLS = 2, 1, 10


def split_of_seed(seed: int) -> str:
    """The split that a seed belongs to."""
    if seed < VALIDATION_SEED_START:
        return EVALUATION
    return VALIDATION if seed < TRAIN_SEED_START else TRAINING


def split_of_cell(kind: str, cell: tuple[str, ...]) -> str:
    """The split that owns a cell of scenario type `kind`."""
    number = zlib.crc32('/'.join((kind, *cell)).encode()) % ALL_CELLS
    if number < EVALUATION_CELLS:
        return EVALUATION
    return VALIDATION if number < EVALUATION_CELLS + VALIDATION_CELLS else TRAINING


@dataclass(frozen=True, slots=True)
class Parameter:
    """A drawn value. span: (low, high) of a number, None of a choice. key: it counts for splits and distances."""

    value: float | str
    span: tuple[float, float] | None
    key: bool


@dataclass(slots=True)
class Draw:
    """Draws the parameters of one scene. Every value depends on type, seed, attempt and its own name alone.

    So the event and its twin get equal values whatever else either of them draws, and a new parameter does not change
    the others. event: whether what the type is about happens; False for the twin. parameters: all that was drawn.
    attempt: 0, and counted up when a scene is drawn again.
    """

    kind: str
    seed: int
    event: bool = True
    attempt: int = 0
    prefix: str = ''
    parameters: dict[str, Parameter] = field(default_factory=dict)
    # One generator for the whole scene, whose values depend on the order of the draws.
    rng: Rng = field(init=False)

    def __post_init__(self) -> None:
        self.rng = rng_for(self.kind, self.seed)

    @property
    def split(self) -> str:
        """The split that the scene has to belong to."""
        return split_of_seed(self.seed)

    def stream(self, name: str) -> Rng:
        """A generator of its own, for sequences such as arrivals; the same for the event and its twin."""
        return np.random.default_rng([self.seed, self.attempt, *_key(self.kind), *_key(self.prefix + name)])

    def uniform(self, name: str, low: float, high: float, *, key: bool = False) -> float:
        """A number between `low` and `high`."""
        part = float(self.stream(name).random())
        if key:
            number = min(int(part * BINS), BINS - 1)
            within = MARGIN + (1.0 - 2.0 * MARGIN) * (part * BINS - number)
            part = (number + within) / BINS
        value = low + (high - low) * part
        self._note(name, Parameter(value, (low, high), key))
        return value

    def integer(self, name: str, low: int, high: int, *, key: bool = False) -> int:
        """A whole number from `low` to `high`, both included."""
        return self.choice(name, range(low, high + 1), key=key)

    def choice(self, name: str, options: Sequence[T], *, key: bool = False) -> T:
        """One of `options`, all equally likely."""
        value = options[int(self.stream(name).integers(len(options)))]
        self._note(name, Parameter(str(value), None, key))
        return value

    def chance(self, name: str, probability: float) -> bool:
        """True with this probability."""
        return float(self.stream(name).random()) < probability

    def side(self, name: str, *, key: bool = False) -> float:
        """1.0 (left) or -1.0 (right)."""
        return self.choice(name, (-1.0, 1.0), key=key)

    def part(self, name: str) -> Draw:
        """The draw of a part of the scene, e.g. one event of a long road: its names begin with `name`."""
        inner = Draw(self.kind, self.seed, self.event, self.attempt, f'{self.prefix}{name}.', self.parameters)
        inner.rng = self.rng
        return inner

    def again(self) -> Draw:
        """The next attempt at the same scene."""
        following = Draw(self.kind, self.seed, self.event, self.attempt + 1, self.prefix)
        following.rng = self.rng
        return following

    def cell(self) -> tuple[str, ...]:
        """The bins of the key parameters, in the order of their names."""
        found = []
        for name, parameter in sorted(self.parameters.items()):
            if not parameter.key:
                continue
            if parameter.span is None:
                found.append(f'{name}={parameter.value}')
            else:
                low, high = parameter.span
                number = min(int((float(parameter.value) - low) / max(high - low, 1e-9) * BINS), BINS - 1)
                found.append(f'{name}={number}')
        return tuple(found)

    def is_of_its_split(self) -> bool:
        """Whether the split of the seed owns the scene. Scenes without key parameters belong to every split."""
        cell = self.cell()
        return not cell or split_of_cell(self.kind, cell) == self.split

    def _note(self, name: str, parameter: Parameter) -> None:
        whole = self.prefix + name
        if whole in self.parameters and self.parameters[whole] != parameter:
            raise ValueError(f'Draw: {whole} is drawn twice, with different ranges')
        self.parameters[whole] = parameter


def distance(one: dict[str, Parameter], other: dict[str, Parameter]) -> float:
    """The largest difference of two scenes in a key parameter, as a share of its range; 1 where a choice differs."""
    largest = 0.0
    for name in {n for n, p in (*one.items(), *other.items()) if p.key}:
        a, b = one.get(name), other.get(name)
        if a is None or b is None or a.span is None or b.span is None:
            same = a is not None and b is not None and a.value == b.value
            largest = max(largest, 0.0 if same else 1.0)
        else:
            span = max(a.span[1], b.span[1]) - min(a.span[0], b.span[0])
            largest = max(largest, abs(float(a.value) - float(b.value)) / max(span, 1e-9))
    return largest


def rng_for(kind: str, seed: int, repetition: int = 0) -> Rng:
    """The random generator of (scenario type, seed), or of one repetition; the same on every machine."""
    key = [seed, zlib.crc32(kind.encode())]
    return np.random.default_rng([*key, repetition] if repetition else key)


def _key(name: str) -> tuple[int, int]:
    data = name.encode()
    return zlib.crc32(data), len(data)
