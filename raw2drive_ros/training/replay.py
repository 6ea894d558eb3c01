"""Batches of sequences from the arrays of many bags: uniform draws, mixed with sequences that hold a terminal step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.training.dataset import FIRST, TERMINAL, BagArrays
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.world_model.mask_codec import MaskCodec


@dataclass(slots=True)
class Batch:
    """masks: (B, T, C*P*P, G, G) float. ego: (B, T, E). vector: (B, T, V). action: (B, T, A) one-hot of the
    action that LED to step t (zero at the first). reward, cont: (B, T), of arriving at t. is_first: (B, T)
    bool, where a sequence begins: an episode, or what follows a gap (`training.dataset`). advice: (B, T, A)
    one-hot of what the expert would do AT step t, zero where it was not asked. images: (B, T, views, height,
    width, 3) uint8 or None.

        t          0        1        2
        obs        o0       o1       o2
        action     (none)   a0       a1      <- led here
        reward     0        r1       r2      <- for arriving here
        is_first   1        0        0
    """

    masks: Tensor
    ego: Tensor
    vector: Tensor
    action: Tensor
    reward: Tensor
    cont: Tensor
    is_first: Tensor
    advice: Tensor
    images: Tensor | None


class Replay:
    """Draws with its own generator, whose state goes into the checkpoint: resuming repeats the same batches.

    short: bags that hold no window of `length` ticks and are left out. Raises BagError when all are.
    """

    def __init__(self, bags: list[BagArrays], codec: MaskCodec, length: int, terminal_share: float, seed: int) -> None:
        self.bags = [bag for bag in bags if len(bag) >= length]
        self.short = [bag.path for bag in bags if len(bag) < length]
        if not self.bags:
            raise BagError(f'no bag holds {length} ticks or more, which one sequence of training takes')
        self.codec, self.length, self.terminal_share = codec, length, terminal_share
        self.rng = np.random.default_rng(seed)
        starts = np.array([len(bag) - length + 1 for bag in self.bags])
        self.cumulative = np.cumsum(starts)
        self.terminals = [(i, int(t)) for i, bag in enumerate(self.bags) for t in np.flatnonzero(bag.flags & TERMINAL)]
        self.ticks = sum(len(bag) for bag in self.bags)

    def _start(self) -> tuple[BagArrays, int]:
        if self.terminals and self.rng.random() < self.terminal_share:
            index, terminal = self.terminals[int(self.rng.integers(len(self.terminals)))]
            bag = self.bags[index]
            low = max(0, terminal - self.length + 1)
            high = min(terminal, len(bag) - self.length)
            return bag, int(self.rng.integers(low, max(low, high) + 1))
        flat = int(self.rng.integers(self.cumulative[-1]))
        index = int(np.searchsorted(self.cumulative, flat, side='right'))
        start = flat - (int(self.cumulative[index - 1]) if index else 0)
        return self.bags[index], start

    def sample(self, batch: int, *, images: bool = False, ranks: Ranks = ALONE) -> Batch:
        """A batch of `batch` sequences; images: with camera frames. ranks: only this process's sequences are read."""
        picks = [self._start() for _ in range(batch * ranks.count)][ranks.rows(batch)]
        slices = [(bag, slice(start, start + self.length)) for bag, start in picks]
        packed = np.concatenate([bag.masks[s] for bag, s in slices])
        deep = self.codec.unpack(packed)
        flags = np.stack([bag.flags[s] for bag, s in slices])
        action, advice = (
            _one_hot(np.stack([getattr(bag, name)[s] for bag, s in slices])) for name in ('action', 'advice')
        )
        frames = None
        if images:
            frames = torch.from_numpy(np.stack([bag.images[s] for bag, s in slices if bag.images is not None]))
        return Batch(
            torch.from_numpy(deep).float().view(batch, self.length, *deep.shape[1:]),
            torch.from_numpy(np.stack([bag.ego[s] for bag, s in slices])),
            torch.from_numpy(np.stack([bag.vector[s] for bag, s in slices])),
            action,
            torch.from_numpy(np.stack([bag.reward[s] for bag, s in slices])),
            torch.from_numpy(1.0 - ((flags & TERMINAL) > 0).astype(np.float32)),
            torch.from_numpy((flags & FIRST) > 0),
            advice,
            frames,
        )


def _one_hot(actions: NDArray[np.int64]) -> Tensor:
    """(...) -> (..., A), zero where there is no action (-1)."""
    index = torch.from_numpy(actions)
    one_hot = torch.nn.functional.one_hot(index.clamp(min=0), ACTION_COUNT).float()
    one_hot[index < 0] = 0.0
    return one_hot
