"""Data-parallel training under `torchrun`: every process takes its own rows of one global batch.

All processes draw the same random numbers for the whole batch and keep their own rows of them, so that generators and
weights stay equal in all processes and a checkpoint of any of them is one of the run.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Ranks:
    """The rank of this process among `count` processes."""

    rank: int = 0
    count: int = 1

    @property
    def leads(self) -> bool:
        """Does this process write files?"""
        return self.rank == 0

    def rows(self, per_process: int) -> slice:
        """This process's rows of a global tensor of `count * per_process` rows."""
        return slice(self.rank * per_process, (self.rank + 1) * per_process)

    def rand(self, rows: int, *shape: int, generator: torch.Generator) -> Tensor:
        """(rows, *shape) uniforms in [0, 1): this process's rows of those that all processes draw."""
        return torch.rand(self.count * rows, *shape, generator=generator)[self.rows(rows)]

    def mean_(self, tensors: Sequence[Tensor]) -> None:
        """Replace every tensor by its mean over all processes, in one all-reduce."""
        if self.count == 1 or not tensors:
            return
        flat = torch.cat([t.reshape(-1) for t in tensors])
        dist.all_reduce(flat)
        flat /= self.count
        for tensor, mean in zip(tensors, flat.split([t.numel() for t in tensors]), strict=True):
            tensor.copy_(mean.view_as(tensor))

    def mean_by_name(self, metrics: dict[str, float]) -> dict[str, float]:
        """Mean of each metric over the processes that have it."""
        if self.count == 1:
            return metrics
        everybody: list[dict[str, float]] = [{}] * self.count
        dist.all_gather_object(everybody, metrics)
        names = dict.fromkeys(name for found in everybody for name in found)
        by_name = {name: [found[name] for found in everybody if name in found] for name in names}
        return {name: sum(values) / len(values) for name, values in by_name.items()}

    def wait(self) -> None:
        """Block until every process has called this."""
        if self.count > 1:
            dist.barrier()


ALONE = Ranks()


@contextmanager
def ranks_of_torchrun() -> Iterator[Ranks]:
    """The processes that `torchrun` started, connected by gloo; one process alone otherwise."""
    count = int(os.environ.get('WORLD_SIZE', '1'))
    if count == 1:
        yield ALONE
        return
    dist.init_process_group('gloo')
    try:
        ranks = Ranks(dist.get_rank(), count)
        yield ranks
        # The first process still writes files when the others are done; if they left now, either side might abort.
        ranks.wait()
    finally:
        dist.destroy_process_group()
