"""One stage-1 step (world model and behaviour) as the teacher's recipe takes it, on random data, and how much each
optimisation saves.

Variants take turns, so that a busy machine slows all of them; least and median wall time, and the ratio of the least.

python -m benchmarks.training_step [--recipe teacher] [--threads 2] [--samples 6]
python -m benchmarks.training_step --collector      only the step as it is, while a collector drives on the same machine
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

# As `raw2drive train` sets them.
os.environ.setdefault('THP_MEM_ALLOC_ENABLE', '1')
os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
os.environ.setdefault('GOMP_SPINCOUNT', '30000')

import torch

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.training import losses
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.recipe import load_recipe
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.world_model import rssm as rssm_module
from raw2drive_ros.world_model.rssm import Rssm

MASK_SHARE = 0.1
STEPS = 2
WARM_S = 8.0


def random_batch(trainer: PrivilegedTrainer) -> Batch:
    """A batch of the trainer's sizes, masks in the memory layout of the replay buffer."""
    t, m = trainer.config.train, trainer.config.model
    b, length, channels = t.batch, t.length, len(m.mask_classes) * m.patch**2
    masks = (torch.rand(b, length, m.grid, m.grid, channels) < MASK_SHARE).float().permute(0, 1, 4, 2, 3)
    action = torch.nn.functional.one_hot(torch.randint(0, ACTION_COUNT, (b, length)), ACTION_COUNT).float()
    first = torch.zeros(b, length, dtype=torch.bool)
    first[:, 0] = True
    ones = torch.ones(b, length)
    ego, vector = torch.rand(b, length, m.ego_size), torch.zeros(b, length, 1)
    return Batch(masks, ego, vector, action, ones, ones, first, action, None)


def plain_mask_loss(logits: torch.Tensor, masks: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """`losses.mask_loss` with the gradient left to autograd."""
    loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, masks, reduction='none')
    return (loss * weights[:, None, None]).sum((1, 2, 3))


def slow_log_probs(logits: torch.Tensor, unimix: float) -> torch.Tensor:
    """`rssm.mixed_log_probs` with a softmax over the last axis."""
    return torch.log(torch.softmax(logits, -1) * (1.0 - unimix) + unimix / logits.shape[-1])


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Within the block, the attribute `name` of `owner` is `value`."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def main() -> None:
    """Take the steps of every variant in turns; print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--recipe', default='teacher')
    parser.add_argument('--threads', type=int, default=2)
    parser.add_argument('--samples', type=int, default=6)
    parser.add_argument('--collector', action='store_true', help='only the step as it is, beside a collector')
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    recipe = load_recipe(options.recipe)
    settings = recipe.settings(0, {})
    trainer = PrivilegedTrainer(make_config(recipe.preset, settings))
    every = PrivilegedTrainer(make_config(recipe.preset, settings | {'decode_share': 1.0}))
    imagines = PrivilegedTrainer(make_config(recipe.preset, settings | {'policy_every': 1}))
    wide = make_config(recipe.preset, settings)
    wide = wide.model_copy(update={'model': wide.model.model_copy(update={'depthwise': False})})
    convolves = PrivilegedTrainer(wide)
    batch = random_batch(trainer)
    rows = batch.masks.contiguous(memory_format=torch.contiguous_format)
    contiguous = Batch(rows, *(getattr(batch, name) for name in Batch.__slots__[1:]))

    def without(owner: Any, name: str, value: Any) -> Callable[[], None]:
        def step() -> None:
            with replaced(owner, name, value):
                trainer.step(batch)

        return step

    cases: dict[str, Callable[[], Any]] = {
        'as it is': lambda: trainer.step(batch),
        'all states decoded': lambda: every.step(batch),
        'imagination at every step': lambda: imagines.step(batch),
        'full 3x3 convolutions': lambda: convolves.step(batch),
        'softmax over the last axis': without(rssm_module, 'mixed_log_probs', slow_log_probs),
        'weight gradients at every step of the loop': without(Rssm, 'maps', Rssm.plain_maps),
        'binary cross-entropy by autograd': without(losses, 'mask_loss', plain_mask_loss),
        'masks channels first in memory': lambda: trainer.step(contiguous),
    }
    if options.collector:
        cases = {'as it is': cases['as it is']}
    with collecting() if options.collector else nullcontext():
        times = sampled(cases, options.samples)
    t = trainer.config.train
    sizes = f'batch {t.batch} x {t.length}, {t.starts} starts x {t.horizon}'
    beside = ', beside a collector' * options.collector
    print(f'{options.recipe}: {sizes}, {options.threads} threads{beside}')
    print(
        '| variant | least ms | median ms | steps/s (median) | least, in ratio to "as it is" |\n|---|---|---|---|---|'
    )
    base = min(times['as it is'])
    for name, found in times.items():
        least, median = min(found), statistics.median(found)
        print(f'| {name} | {least:.0f} | {median:.0f} | {1e3 / median:.1f} | {least / base:.2f} |')


@contextmanager
def collecting() -> Iterator[None]:
    """Within the block, one of the recipe's collectors runs: the shipped teacher with the expert's advice, into a
    temporary folder."""
    with tempfile.TemporaryDirectory(prefix='raw2drive_bench_') as folder:
        command = [
            sys.executable,
            '-m',
            'raw2drive_ros.cli.main',
            'collect',
            '--driver',
            'privileged',
            '--routes',
            'all',
        ]
        command += ['--advice', '--advice-every', '8', '--no-cameras', '--ticks', '1000000', '--out', f'{folder}/bags']
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            # It needs this long to start up.
            time.sleep(WARM_S)
            if process.poll() is not None:
                raise SystemExit('the collector ended; what does `raw2drive collect --driver privileged` say?')
            yield
        finally:
            process.terminate()
            process.wait()


def sampled(cases: dict[str, Callable[[], Any]], samples: int) -> dict[str, list[float]]:
    """case -> milliseconds per step of each sample; cases take turns, and the first turn, a warm-up, is not counted."""
    times: dict[str, list[float]] = {name: [] for name in cases}
    # An even number of steps per sample: with `policy_every: 2`, each sample holds one imagination.
    for sample in range(samples + 1):
        for name, step in cases.items():
            started = time.perf_counter()
            for _ in range(STEPS):
                step()
            if sample:
                times[name].append((time.perf_counter() - started) * 1e3 / STEPS)
    return times


if __name__ == '__main__':
    main()
