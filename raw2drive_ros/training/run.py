"""A training run: one folder with config, metrics, pictures and checkpoints, and the loop that fills it."""

from __future__ import annotations

import fcntl
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.contracts.errors import CheckpointError, UsageError
from raw2drive_ros.recording.bag_reader import find_bags
from raw2drive_ros.training.checkpoint import Trainer, load_checkpoint, save_checkpoint
from raw2drive_ros.training.config import RunConfig, make_config, overridden, read_run_config
from raw2drive_ros.training.dataset import BagArrays, data_line, load_bags, rig_of
from raw2drive_ros.training.interrupts import noted_interrupts
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

DEFAULT_PRESET = 'laptop'
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
    preset: str | None = None,
    overrides: dict[str, Any] | None = None,
    teacher_run: Path | None = None,
    *,
    report: Report = lambda step, metrics: None,
    loading: Callable[[int, int], None] = lambda done, total: None,
    ranks: Ranks = ALONE,
) -> Trainer:
    """Train `stage` in folder `run` up to `steps` gradient steps, resuming where the folder stopped.

    preset: of a new run, `DEFAULT_PRESET` where none is given. An existing run keeps its own configuration, with
    `overrides` applied (recorded in config.json). ranks: the processes of `torchrun`, each with a batch of its own. At
    Ctrl-C or SIGTERM the step is finished and a checkpoint written first. Raises UsageError for another preset than an
    existing run's, CheckpointError while another process trains in that folder.
    """
    folder = RunFolder(run)
    resumed = newest_checkpoint(folder.checkpoints)
    config = configuration(run, preset, overrides or {})
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
    window: dict[str, Any] = {}
    if ranks.leads:
        print(data_line(bags, replay.short, length), file=sys.stderr)
    with folder.alone() if ranks.leads else nullcontext():
        if resumed is not None:
            state = load_checkpoint(resumed, trainer, replay)
            if state['stage'] != stage:
                raise CheckpointError(f'{run}: is a {state["stage"]} run, not a {stage} one')
            window = state.get('window', {})
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
        _loop(trainer, replay, folder, steps, report, ranks, raw=raw, window=window)
    return trainer


def configuration(run: Path | None, preset: str | None, overrides: dict[str, Any]) -> RunConfig:
    """What `train` trains with in the folder `run`, which need not exist. Raises UsageError, ConfigError and
    CheckpointError as `train` does."""
    if run is None or newest_checkpoint(run / CHECKPOINTS) is None:
        return make_config(preset or DEFAULT_PRESET, overrides)
    found = read_run_config(run)
    if preset not in (None, found.preset):
        raise UsageError(f'--preset {preset}: {run} is a run of preset {found.preset} and keeps it; give another --run')
    return overridden(found, overrides)


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
    trainer: Trainer,
    replay: Replay,
    folder: RunFolder,
    steps: int,
    report: Report,
    ranks: Ranks,
    *,
    raw: bool,
    window: dict[str, Any],
) -> None:
    """window: what an interrupted call had gathered since its last line of metrics."""
    t = trainer.config.train
    size = t.raw_batch if raw else t.batch
    sums: dict[str, list[float]] = window.get('sums', {})
    overlap: dict[str, float] = window.get('overlap', {})
    timed, started = 0, time.perf_counter()
    # Processes of torchrun would stop at different steps and wait for each other: they end at once, as before.
    with noted_interrupts(wanted=ranks.count == 1) as interrupts:
        while trainer.steps < steps and not interrupts.requested:
            batch = replay.sample(size, images=raw, ranks=ranks)
            factor = decay_factor(trainer.steps, steps, t.decay_share, t.decay_end)
            metrics = trainer.step(batch, factor) | {'learning_rate/factor': factor}
            timed += 1
            for name, value in metrics.items():
                sums.setdefault(name, []).append(value)
            if ranks.leads and (trainer.steps % t.picture_every == 0 or trainer.steps == steps):
                overlap = overlap_by_class(trainer, batch)
                save_pictures(folder.path / 'pictures', trainer, batch, replay.codec)
            if trainer.steps % t.log_every == 0 or trainer.steps == steps:
                means = {name: float(np.mean(values)) for name, values in sums.items()}
                means['time/step_s'] = (time.perf_counter() - started) / timed
                means = ranks.mean_by_name(means) | overlap
                overlap = {}
                if ranks.leads:
                    folder.log(trainer.steps, means)
                    report(trainer.steps, means)
                sums, timed, started = {}, 0, time.perf_counter()
            due = trainer.steps % t.checkpoint_every == 0 or trainer.steps == steps
            if ranks.leads and (due or interrupts.requested):
                # So that a resumed run logs the same means.
                extra = {'window': {'sums': sums, 'overlap': overlap}} if sums or overlap else {}
                saved = save_checkpoint(folder.checkpoints, trainer, replay, extra)
                if interrupts.requested:
                    print(f'checkpoint {saved} written; the same command goes on from there', file=sys.stderr)
    interrupts.deliver()
