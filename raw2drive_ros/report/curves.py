"""Training runs as curves: `metrics.jsonl` over the steps, and success per scenario type over the validated rounds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.results import read_results
from raw2drive_ros.report.charts import MAX_RUNS, PALETTE
from raw2drive_ros.training.pictures import DREAM_TICKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOSSES = ('masks', 'ego', 'reward', 'continue', 'dyn', 'rep', 'advice', 'imitation', 'actor', 'critic')
POLICY = ('return', 'value', 'reward', 'entropy', 'agreement')
OTHERS = {
    'learning_rate/factor': 'learning rate (share of the full one)',
    'time/step_s': 'seconds per step',
    'validation/driving_score': 'validation: driving score',
    'validation/success_percent': 'validation: success %',
}
# Fields that `RunFolder.log` writes beside the metrics.
NOT_METRICS = ('step', 'time')
COLUMNS, PANEL_INCHES = 4, (4.2, 2.1)
# Height of a heat map: of its title and slanted labels, and of each row.
MAP_INCHES, ROUND_INCHES = 2.0, 0.26
# The axis is logarithmic where a loss falls by more than this factor.
WIDE = 20.0
# Curves of fewer points than this get markers.
FEW_POINTS = 40


@dataclass(frozen=True, slots=True)
class Round:
    """One validation. success: scenario type -> share of successes in [0, 1] among the drives that are done."""

    number: str
    driven: int
    wanted: int
    success: dict[str, float]

    @property
    def title(self) -> str:
        return self.number if self.driven == self.wanted else f'{self.number} ({self.driven} of {self.wanted})'


@dataclass(frozen=True, slots=True)
class RunCurves:
    """metrics: name -> (steps, values), both (N,), in the order of the steps."""

    name: str
    metrics: dict[str, tuple[Float64, Float64]]
    rounds: list[Round]


@dataclass(frozen=True, slots=True)
class Panel:
    """solid, dashed: names of metrics."""

    title: str
    solid: str
    dashed: str = ''


def read_run(run: Path, name: str | None = None) -> RunCurves:
    """The metrics and validations of a run folder, also of one still in training: a truncated last line is left out.

    Raises CheckpointError, and ResultsError for a damaged validation.
    """
    found = _read_metrics(run / 'metrics.jsonl')
    metrics = {key: (np.array(list(points), float), np.array(list(points.values()))) for key, points in found.items()}
    files = sorted((run / 'validation').glob('round_*.jsonl'))
    # An evaluation that has just begun has not written its header yet.
    rounds = [_read_round(file) for file in files if file.stat().st_size]
    return RunCurves(name or run.resolve().name, metrics, rounds)


def _read_metrics(file: Path) -> dict[str, dict[int, float]]:
    """name -> step -> value. Raises CheckpointError."""
    try:
        lines = file.read_text(encoding='utf-8').splitlines()
    except OSError as error:
        raise CheckpointError(f'{file.parent}: not a training run (metrics.jsonl: {error.strerror})') from error
    except UnicodeDecodeError as error:
        raise CheckpointError(f'{file}: not text: {error}') from error
    found: dict[str, dict[int, float]] = {}
    before = 0
    for number, line in enumerate(lines, 1):
        try:
            body = json.loads(line)
            step = int(body['step'])
            values = {name: float(value) for name, value in body.items() if name not in NOT_METRICS}
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            if isinstance(error, json.JSONDecodeError) and number == len(lines):
                break
            raise CheckpointError(f'{file}: line {number} holds no metrics: {error}') from error
        if step < before:
            # Killed before its first checkpoint and started again: what is later belongs to work that was lost.
            found = {name: {s: v for s, v in points.items() if s <= step} for name, points in found.items()}
        before = step
        for name, value in values.items():
            found.setdefault(name, {})[step] = value
    found = {name: points for name, points in found.items() if points}
    if not found:
        raise CheckpointError(f'{file}: holds no metrics yet')
    return found


def _read_round(file: Path) -> Round:
    results = read_results(file)
    drives: dict[str, list[bool]] = {}
    for row in results.rows:
        drives.setdefault(row['type'], []).append(row['success'])
    success = {kind: float(np.mean(values)) for kind, values in drives.items()}
    return Round(file.stem.removeprefix('round_').lstrip('0'), len(results.rows), len(results.wanted), success)


def read_runs(paths: Sequence[Path]) -> list[RunCurves]:
    """Runs named by their folder; where two have the same name, the parent folder is added.

    Raises CheckpointError or ResultsError.
    """
    if not 1 <= len(paths) <= MAX_RUNS:
        raise CheckpointError(f'{len(paths)} runs: give 1 to {MAX_RUNS}')
    full = [path.resolve() for path in paths]
    names = [path.name for path in full]
    return [
        read_run(path, path.name if names.count(path.name) == 1 else f'{path.parent.name}/{path.name}') for path in full
    ]


def panels_of(runs: Sequence[RunCurves]) -> list[Panel]:
    """The panels to draw: losses, class overlaps, policy, rates, validation. No panel without a metric."""
    names = list(dict.fromkeys(name for run in runs for name in run.metrics))

    def kept(prefix: str, known: Iterable[str]) -> list[str]:
        return [name for name in known if f'{prefix}/{name}' in names]

    # The raw stream has loss terms of its own.
    others = sorted(n.removeprefix('loss/') for n in names if n.startswith('loss/'))
    found = [Panel(f'loss: {n}', f'loss/{n}') for n in kept('loss', dict.fromkeys((*LOSSES, *others)))]
    classes = dict.fromkeys(n.partition('/')[2] for n in names if n.startswith(('iou/', 'iou_dream/')))
    found += [Panel(f'overlap: {n}', f'iou/{n}', f'iou_dream/{n}') for n in classes]
    found += [Panel(f'policy: {n}', f'policy/{n}') for n in kept('policy', POLICY)]
    return found + [Panel(title, name) for name, title in OTHERS.items() if name in names]


def draw(runs: Sequence[RunCurves]) -> Figure:
    """All panels, below them a heat map for each run that was validated."""
    # Imported late: it takes half a second.
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    panels = panels_of(runs)
    maps = [run for run in runs if run.rounds]
    rows = -(-len(panels) // COLUMNS)
    heights = [PANEL_INCHES[1]] * rows + [MAP_INCHES + ROUND_INCHES * len(run.rounds) for run in maps]
    figure = Figure((COLUMNS * PANEL_INCHES[0], sum(heights) + 0.6), layout='constrained')
    grid = figure.add_gridspec(len(heights), COLUMNS, height_ratios=heights)
    for index, panel in enumerate(panels):
        _draw_panel(figure.add_subplot(grid[index // COLUMNS, index % COLUMNS]), panel, runs)
    for index, run in enumerate(maps):
        _draw_map(figure.add_subplot(grid[rows + index, :]), run)
    keys = [Line2D([], [], color=colour, label=run.name) for run, colour in zip(runs, PALETTE, strict=False)]
    if any(panel.dashed for panel in panels):
        keys.append(
            Line2D([], [], color='0.4', linestyle='--', marker='x', label=f'imagined, {DREAM_TICKS} ticks ahead')
        )
    figure.legend(handles=keys, loc='outside upper left', ncols=len(keys), frameon=False)
    return figure


def _draw_panel(axis: Axes, panel: Panel, runs: Sequence[RunCurves]) -> None:
    values: list[float] = []
    for run, colour in zip(runs, PALETTE, strict=False):
        for name, style, dot in ((panel.solid, '-', '.'), (panel.dashed, '--', 'x')):
            if name in run.metrics:
                steps, y = run.metrics[name]
                marker = dot if len(steps) < FEW_POINTS else ''
                axis.plot(steps, y, style, color=colour, linewidth=1.1, marker=marker, markersize=4)
                values += y[np.isfinite(y)].tolist()
    if panel.solid.startswith('loss/') and values and min(values) > 0 and max(values) > WIDE * min(values):
        axis.set_yscale('log')
    if panel.solid.startswith('iou/'):
        axis.set_ylim(-0.03, 1.03)
    if panel.solid.startswith('validation/'):
        axis.set_ylim(-3, 103)
    # All panels have the same range of steps, so that a step is at the same place in each.
    axis.set_xlim(0, 1.02 * max(steps[-1] for run in runs for steps, _ in run.metrics.values()))
    axis.set_title(panel.title, fontsize=9)
    axis.tick_params(which='both', labelsize=7)
    axis.grid(alpha=0.3)


def _draw_map(axis: Axes, run: RunCurves) -> None:
    """Rounds downward, scenario types to the right; a type that was not driven in a round stays white."""
    kinds = sorted({kind for one in run.rounds for kind in one.success})
    table = np.array([[one.success.get(kind, np.nan) for kind in kinds] for one in run.rounds])
    table = table.reshape(len(run.rounds), len(kinds))
    shown: Any = axis.imshow(table, cmap='cividis', vmin=0.0, vmax=1.0, aspect='auto', interpolation='nearest')
    axis.set_xticks(range(len(kinds)), kinds, rotation=60, ha='right', rotation_mode='anchor', fontsize=7)
    axis.set_yticks(range(len(run.rounds)), [one.title for one in run.rounds], fontsize=8)
    axis.set_ylabel('round')
    axis.set_title(f'{run.name}: share of validation drives that succeed', fontsize=9)
    axis.figure.colorbar(shown, ax=axis, pad=0.01)


def save_curves(target: Path, runs: Sequence[RunCurves]) -> int:
    """Write the picture; returns its number of panels, heat maps included. Raises OSError."""
    figure = draw(runs)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=100)
    return len(panels_of(runs)) + sum(bool(run.rounds) for run in runs)
