"""Runs a training recipe: collect, train, validate, round by round; called again, it resumes where it stopped."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from raw2drive_ros.artifact import restore_folder, whole_folder
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.evaluation.results import read_results
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.progress import bar
from raw2drive_ros.safe_path import safe_path_variables
from raw2drive_ros.training.recipe import Collection, Recipe
from raw2drive_ros.training.run import RunFolder, train
from raw2drive_ros.world_model.run_files import BEST, CHECKPOINTS, newest_checkpoint

POLL_S = 1.0
DONE = 'collected.json'


@dataclass(slots=True)
class Job:
    """A verb of `raw2drive` in a process of its own; its output goes to the file `log`."""

    arguments: list[str]
    log: Path
    process: subprocess.Popen[bytes] = field(init=False)

    def __post_init__(self) -> None:
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open('wb') as out:
            command = [sys.executable, '-m', 'raw2drive_ros.cli.main', *self.arguments]
            environment = os.environ | safe_path_variables()
            self.process = subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT)

    @property
    def done(self) -> int:
        """Units of work done, according to its last line of progress."""
        found = re.findall(rb': (\d+)/\d+ ', self.log.read_bytes()[-2000:])
        return int(found[-1]) if found else 0

    def finish(self) -> None:
        """Wait for it. Raises CheckpointError with the last lines of its output when it failed."""
        if self.process.wait() != 0:
            tail = self.log.read_text(errors='replace').strip().splitlines()[-3:]
            raise CheckpointError(f'raw2drive {self.arguments[0]} failed ({self.log}): {" | ".join(tail)}')


def watch(title: str, jobs: list[Job], total: int, unit: str) -> None:
    """Wait for all jobs with one progress bar; when one fails or the user stops, the others are stopped."""
    try:
        with bar(title, total, unit) as advance:
            while any(job.process.poll() is None for job in jobs):
                time.sleep(POLL_S)
                advance(min(total, sum(job.done for job in jobs)))
                if any(job.process.poll() not in (None, 0) for job in jobs):
                    break
        for job in jobs:
            if job.process.poll() not in (None, 0):
                job.finish()
        for job in jobs:
            job.finish()
    finally:
        for job in jobs:
            if job.process.poll() is None:
                job.process.terminate()
        for job in jobs:
            job.process.wait()


def run_recipe(recipe: Recipe, run: Path, cache: Path, overrides: dict[str, Any], workers: int) -> None:
    """All rounds that are not done yet. Raises CheckpointError, BagError, ConfigError or ResultsError."""
    for index in range(len(recipe.rounds)):
        title = f'round {index + 1} of {len(recipe.rounds)}'
        newest = newest_checkpoint(run / CHECKPOINTS)
        trained = int(newest.name) if newest else 0
        total = recipe.total_steps(index)
        if trained < total:
            _collect(recipe, index, run, int(overrides.get('seed', recipe.set.get('seed', 0))), workers, title)
            _train(recipe, index, run, cache, overrides, title)
        if recipe.validation and trained <= total:
            _validate(recipe, index, run, workers, title)


def _collect(recipe: Recipe, index: int, run: Path, seed: int, workers: int, title: str) -> None:
    waiting: list[tuple[Collection, int, Path]] = []
    for number, collection in enumerate(recipe.rounds[index].collect):
        target = run / 'bags' / f'{index:02d}_{number}_{collection.driver}'
        if not (target / DONE).is_file():
            # A collector that was killed left an incomplete folder; with the same seed it drives the same routes again.
            shutil.rmtree(target, ignore_errors=True)
            waiting.append((collection, number, target))
    while waiting:
        now, waiting = waiting[:workers], waiting[workers:]
        jobs = []
        for collection, number, target in now:
            driver_seed = recipe.seed(seed, index, number)
            newest = newest_checkpoint(run / CHECKPOINTS) or run
            failed = failures_by_type(run, index) if collection.focus else {}
            arguments = collection.arguments(recipe, driver_seed, newest, target, failed)
            jobs.append(Job(arguments, run / 'logs' / f'{target.name}.log'))
        watch(
            f'{title}: collecting ({", ".join(c.title for c, _, _ in now)})',
            jobs,
            sum(c.ticks for c, _, _ in now),
            'ticks',
        )
        for job, (_, _, target) in zip(jobs, now, strict=True):
            (target / DONE).write_text(json.dumps(job.arguments))


def _train(recipe: Recipe, index: int, run: Path, cache: Path, overrides: dict[str, Any], title: str) -> None:
    settings = recipe.settings(index, overrides)
    with bar(f'{title}: training', recipe.total_steps(index), 'steps') as advance:

        def report(step: int, metrics: dict[str, float]) -> None:
            shown = ('loss/masks', 'loss/reward', 'loss/imitation', 'policy/reward')
            advance(step, ' '.join(f'{k.split("/")[1]} {metrics[k]:.3g}' for k in shown if k in metrics))

        total = recipe.total_steps(index)
        train('privileged', run, recipe.bags(index, run / 'bags'), cache, total, recipe.preset, settings, report=report)


def _validate(recipe: Recipe, index: int, run: Path, workers: int, title: str) -> None:
    """Drive the validation suite; the best round so far is kept as `best`."""
    newest = newest_checkpoint(run / CHECKPOINTS)
    if newest is None or int(newest.name) != recipe.total_steps(index):
        return
    results = run / 'validation' / f'round_{index + 1:02d}.jsonl'
    arguments = ['evaluate', '--driver', 'privileged', '--run', str(newest)]
    arguments += ['--suite', recipe.validation, '--workers', str(workers), '--out', str(results), '--json']
    job = Job(arguments, run / 'logs' / f'validation_{index + 1:02d}.log')
    watch(f'{title}: validation', [job], len(load_suite(recipe.validation).routes), 'routes')
    rows = read_results(results).rows
    score = sum(row['driving_score'] for row in rows) / len(rows)
    success = 100.0 * sum(row['success'] for row in rows) / len(rows)
    RunFolder(run).log(int(newest.name), {'validation/driving_score': score, 'validation/success_percent': success})
    print(f'{title}: validation driving score {score:.1f}, success {success:.1f} %')
    keep_if_best(run, newest, {'suite': recipe.validation, 'round': index + 1, 'driving_score': score})


def failures_by_type(run: Path, index: int) -> dict[str, float]:
    """Type -> share of its routes that failed in the last two validations before round `index`. Raises ResultsError."""
    files = [run / 'validation' / f'round_{number:02d}.jsonl' for number in (index - 1, index)]
    driven: dict[str, list[bool]] = {}
    for file in files:
        # A validation that was killed right after its start has not written its header.
        if file.is_file() and file.stat().st_size:
            for row in read_results(file).rows:
                driven.setdefault(row['type'], []).append(row['success'])
    return {kind: 1.0 - sum(rows) / len(rows) for kind, rows in driven.items()}


def keep_if_best(run: Path, checkpoint: Path, score: dict[str, Any]) -> bool:
    """Copy a checkpoint to `run/best` when its `driving_score` beats that of the one there."""
    best = run / BEST
    # What version 0.2 called the folder that it was replacing when it was killed.
    before = run / f'{BEST}.old'
    if before.is_dir() and not best.is_dir():
        before.replace(best)
    restore_folder(best)
    if best.is_dir() and score['driving_score'] <= json.loads((best / 'score.json').read_text())['driving_score']:
        return False
    with whole_folder(best) as folder:
        shutil.copytree(checkpoint, folder, dirs_exist_ok=True)
        (folder / 'score.json').write_text(json.dumps(score))
    return True
