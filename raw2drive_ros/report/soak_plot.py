"""The resources that the processes of a soak run held, over simulated hours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from raw2drive_ros.evaluation.soak import Sample
from raw2drive_ros.report.charts import PALETTE

PANELS = {
    'memory_mib': 'memory without shared, MiB',
    'handles': 'handles',
    'threads': 'threads',
    'shared_segments': 'shared-memory segments',
    'logs_mib': 'log folder, MiB',
}
COLUMNS, PANEL_INCHES = 3, (4.6, 2.6)


def save_soak(path: Path, samples: Sequence[Sample]) -> None:
    """One panel per quantity, one line per process; a dotted line where the graph was started again."""
    from matplotlib.figure import Figure

    # Samples of graphs that ran side by side are interleaved.
    samples = sorted(samples, key=lambda sample: sample.part)
    rows = -(-len(PANELS) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * PANEL_INCHES[0], rows * PANEL_INCHES[1]), layout='constrained')
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    hours, starts = _time_line(samples)
    names = sorted({name.split('/')[0] for sample in samples for name in sample.values})
    for axis, (quantity, title) in zip(axes, PANELS.items()):
        for name, colour in zip(names, PALETTE):
            key = f'{name}/{quantity}'
            points = [(x, sample.values[key]) for x, sample in zip(hours, samples) if key in sample.values]
            if points:
                axis.plot(*zip(*points), color=colour, lw=1.2, label=name)
        for start in starts:
            axis.axvline(start, color='0.6', lw=0.8, ls=':')
        axis.set(title=title, xlabel='simulated hours', ylim=(0, None))
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7)
    for axis in axes[len(PANELS) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=110)


def _time_line(samples: Sequence[Sample]) -> tuple[list[float], list[float]]:
    """Hours of each sample with the parts laid end to end, and where parts begin (the first left out)."""
    hours: list[float] = []
    starts: list[float] = []
    offset = last = 0.0
    part = samples[0].part if samples else 0
    for sample in samples:
        if sample.part != part:
            part, offset = sample.part, last
            starts.append(offset)
        last = offset + sample.simulated_s / 3600.0
        hours.append(last)
    return hours, starts
