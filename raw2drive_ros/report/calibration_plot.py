"""The picture of a calibration: reliability of the continue head above, reward and value below."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.report.calibration import EDGES, HORIZONS, Traces
from raw2drive_ros.report.charts import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE = PALETTE[:2]
CELLS = 70
# Share of the states that a density plot clips at either end: a few crashes would leave no room for the rest.
TAIL = 0.002


def draw(title: str, found: dict[str, Any], states: Traces) -> Figure:
    """found: `calibration.numbers` of the episodes that `states` is joined from."""
    # Imported late: it takes half a second.
    from matplotlib.figure import Figure

    figure = Figure((15, 9), layout='constrained')
    axes = figure.subplots(2, 3)
    for axis, steps in zip(axes[0], HORIZONS, strict=True):
        _reliability(axis, steps, found['continue'][str(steps)])
    compared = states.reward_known
    _density(axes[1, 0], states.reward[compared], states.recorded[compared], 'reward', 'recorded', found['reward'])
    _deciles(axes[1, 1], found['reward']['deciles'])
    compared = states.value_known
    value = found['value']['all']
    _density(axes[1, 2], states.value[compared], states.returned[compared], 'value', 'realised return', value)
    figure.suptitle(title)
    return figure


def save_calibration(target: Path, title: str, found: dict[str, Any], states: Traces) -> Path:
    """A PNG. Raises OSError."""
    figure = draw(title, found, states)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=100)
    return target


def _reliability(axis: Axes, steps: int, found: dict[str, Any]) -> None:
    """The observed frequency against the predicted one, and behind it how many states each bin holds."""
    axis.set_title(f'end within {steps} step{"s" * (steps > 1)} on the recorded actions\n{_score(found)}', fontsize=10)
    axis.set(xlabel='predicted probability', ylabel='share that ended', xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    counts = axis.twinx()
    counts.bar(
        [b['low'] for b in found['bins']],
        [b['states'] for b in found['bins']],
        [b['high'] - b['low'] for b in found['bins']],
        align='edge',
        color='0.88',
        edgecolor='white',
    )
    counts.set_yscale('log')
    counts.set_ylabel('states', color='0.5')
    counts.tick_params(colors='0.5', labelsize=8)
    # Draw the counts behind the curve.
    axis.set_zorder(counts.get_zorder() + 1)
    axis.patch.set_visible(False)
    axis.plot([0, 1], [0, 1], color='0.4', linewidth=0.8, linestyle='--')
    predicted, happened = ([b[name] for b in found['bins']] for name in ('predicted', 'happened'))
    axis.plot(predicted, happened, marker='o', color=BLUE, markersize=4)
    axis.set_xticks(EDGES[[0, *range(3, len(EDGES))]])
    axis.tick_params(labelsize=8)


def _score(found: dict[str, Any]) -> str:
    if found['brier'] is None:
        return 'no states'
    return f'Brier {found["brier"]:.4f}, always the rate {found["brier_of_rate"]:.4f}; ended {found["happened"]:.2%}'


def _density(axis: Axes, predicted: Float64, true: Float64, name: str, of: str, found: dict[str, Any]) -> None:
    from matplotlib.colors import LogNorm

    axis.set(xlabel=of, ylabel=f'predicted {name}')
    figures = [f'{key} {found[key]:.3f}' for key in ('r2', 'correlation', 'bias') if found[key] is not None]
    axis.set_title(f'{name}, {found["states"]} states\n{", ".join(figures)}', fontsize=10)
    if not len(true):
        return
    low, high = (float(np.quantile(np.concatenate([predicted, true]), q)) for q in (TAIL, 1.0 - TAIL))
    low, high = low - 0.05 * (high - low) - 1e-6, high + 0.05 * (high - low) + 1e-6
    cells = np.linspace(low, high, CELLS)
    right, up = (np.clip(x, low, high) for x in (true, predicted))
    shown = axis.hist2d(right, up, bins=(cells, cells), norm=LogNorm())[3]
    axis.figure.colorbar(shown, ax=axis, label='states')
    axis.plot([low, high], [low, high], color='0.4', linewidth=0.8, linestyle='--')


def _deciles(axis: Axes, found: list[dict[str, Any]]) -> None:
    axis.bar(range(len(found)), [part['error'] for part in found], color=ORANGE)
    axis.axhline(0.0, color='0.4', linewidth=0.8)
    names = [f'{part["low"]:.2f} to {part["high"]:.2f}' for part in found]
    axis.set_xticks(range(len(found)), names, fontsize=8, rotation=30, ha='right', rotation_mode='anchor')
    axis.set(xlabel='decile of the predicted reward', ylabel='predicted - recorded')
    axis.set_title('mean error of the reward', fontsize=10)
