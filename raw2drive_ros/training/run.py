"""A training run: one folder with config, metrics, pictures and checkpoints, and the loop that fills it."""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.recording.bag_reader import find_bags
from raw2drive_ros.training.checkpoint import Trainer, load_checkpoint, save_checkpoint
from raw2drive_ros.training.config import RunConfig, make_config, overridden, read_run_config
from raw2drive_ros.training.dataset import BagArrays, load_bags, rig_of
from raw2drive_ros.training.left_out import say_left_out
from raw2drive_ros.training.optimiser import decay_factor
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.training.pictures import overlap_by_class, save_pictures
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.run_files import CHECKPOINTS, CONFIG, newest_checkpoint
from raw2drive_ros.world_model.teacher import load_teacher

Report = Callable[[int, dict[str, float]], None]


@dataclass(slots=True)
class RunFolder:
    """config.json, metrics.jsonl, tensorboard/, pictures/, checkpoints/ of one run."""

    path: Path
    _board: Any = field(default=None, init=False)

    @property
    def checkpoints(self) -> Path:
        return self.path / CHECKPOINTS

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Locks the folder: two trainers in it would truncate each other's metrics and delete each other's checkpoints.

        Raises CheckpointError while another process holds the lock.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with (self.path / '.lock').open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise CheckpointError(f'{self.path}: another process is training there') from error
            yield

    def save_config(self, config: RunConfig, metadata: dict[str, Any]) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        body = {'config': config.model_dump(mode='json')} | metadata
        # Written atomically, because no checkpoint can be resumed without it.
        write_whole(self.path / CONFIG, json.dumps(body, indent=2), durable=True)

    def log(self, step: int, metrics: dict[str, float]) -> None:
        with (self.path / 'metrics.jsonl').open('a') as file:
            file.write(json.dumps({'step': step, 'time': time.time()} | metrics) + '\n')
        if self._board is None:
            from tensorboardX import SummaryWriter

            self._board = SummaryWriter(str(self.path / 'tensorboard'))
        for name, value in metrics.items():
            self._board.add_scalar(name, value, step)

    def truncate(self, step: int) -> None:
        """Drop metrics after `step` and an incomplete last line: a killed run left them, and repeats these steps."""
        file = self.path / 'metrics.jsonl'
        if not file.exists():
            return
        text = file.read_text()
        whole = text[: text.rfind('\n') + 1].splitlines()
        write_whole(file, ''.join(line + '\n' for line in whole if json.loads(line)['step'] <= step))


def set_threads(count: int) -> None:
    """Fixed threads make a run repeatable; huge pages halve the cost of large elementwise kernels."""
    os.environ.setdefault('THP_MEM_ALLOC_ENABLE', '1')
    torch.set_num_threads(count)


def train(
    stage: str,
    run: Path,
    bag_roots: list[Path],
    cache: Path,
    steps: int,
    preset: str = 'laptop',
    overrides: dict[str, Any] | None = None,
    teacher_run: Path | None = None,
    *,
    report: Report = lambda step, metrics: None,
    loading: Callable[[int, int], None] = lambda done, total: None,
    ranks: Ranks = ALONE,
) -> Trainer:
    """Train `stage` in folder `run` up to `steps` gradient steps, resuming where the folder stopped.

    An existing run keeps its own configuration, with `overrides` applied (recorded in config.json); `preset` is then
    ignored. ranks: the processes of `torchrun`, each with a batch of its own. Raises CheckpointError while another
    process trains in that folder.
    """
    folder = RunFolder(run)
    resumed = newest_checkpoint(folder.checkpoints)
    if resumed is not None:
        config = overridden(read_run_config(run), overrides or {})
    else:
        config = make_config(preset, overrides)
    set_threads(config.train.threads)
    paths = find_bags(bag_roots)
    raw = stage == 'raw'
    if not ranks.leads:
        # The leading process builds the cache.
        ranks.wait()
    bags = load_bags(paths, cache, config.model, cameras=raw, progress=loading)
    if ranks.leads:
        ranks.wait()
    trainer = _make_trainer(stage, config, bags, teacher_run, steps, ranks)
    t = config.train
    length = t.raw_length if raw else t.length
    say_left_out(bag_roots, bags, length, ranks)
    replay = Replay(bags, MaskCodec(config.model), length, t.terminal_share, t.seed)
    with folder.alone() if ranks.leads else nullcontext():
        if resumed is not None:
            state = load_checkpoint(resumed, trainer, replay)
            if state['stage'] != stage:
                raise CheckpointError(f'{run}: is a {state["stage"]} run, not a {stage} one')
        if ranks.leads:
            folder.truncate(trainer.steps)
        metadata = {
            'stage': stage,
            'teacher': str(teacher_run) if teacher_run else None,
            'processes': ranks.count,
            'bags': [{'path': str(b.path), 'id': b.identity, 'ticks': len(b)} for b in bags],
        }
        if ranks.leads:
            folder.save_config(config, metadata)
        _loop(trainer, replay, folder, steps, report, ranks, raw=raw)
    return trainer


def _make_trainer(
    stage: str, config: RunConfig, bags: list[BagArrays], teacher_run: Path | None, steps: int, ranks: Ranks
) -> Trainer:
    if stage == 'privileged':
        return PrivilegedTrainer(config, ranks)
    if teacher_run is None:
        raise CheckpointError('stage raw needs the run of a privileged teacher (--teacher)')
    teacher = load_teacher(teacher_run)
    if teacher.config != config.model:
        raise CheckpointError(f'{teacher_run}: its model sizes differ from preset {config.preset}')
    return RawTrainer(config, teacher, rig_of(bags[0].path), steps, ranks)


def _loop(
    trainer: Trainer, replay: Replay, folder: RunFolder, steps: int, report: Report, ranks: Ranks, *, raw: bool
) -> None:
    t = trainer.config.train
    size = t.raw_batch if raw else t.batch
    sums: dict[str, list[float]] = {}
    overlap: dict[str, float] = {}
    started = time.perf_counter()
    while trainer.steps < steps:
        batch = replay.sample(size, images=raw, ranks=ranks)
        factor = decay_factor(trainer.steps, steps, t.decay_share, t.decay_end)
        metrics = trainer.step(batch, factor) | {'learning_rate/factor': factor}
        for name, value in metrics.items():
            sums.setdefault(name, []).append(value)
        if ranks.leads and (trainer.steps % t.picture_every == 0 or trainer.steps == steps):
            overlap = overlap_by_class(trainer, batch)
            save_pictures(folder.path / 'pictures', trainer, batch, replay.codec)
        if trainer.steps % t.log_every == 0 or trainer.steps == steps:
            means = {name: float(np.mean(values)) for name, values in sums.items()}
            means['time/step_s'] = (time.perf_counter() - started) / len(sums['grad/model'])
            means = ranks.mean_by_name(means) | overlap
            overlap = {}
            if ranks.leads:
                folder.log(trainer.steps, means)
                report(trainer.steps, means)
            sums, started = {}, time.perf_counter()
        if ranks.leads and (trainer.steps % t.checkpoint_every == 0 or trainer.steps == steps):
            save_checkpoint(folder.checkpoints, trainer, replay, {})
