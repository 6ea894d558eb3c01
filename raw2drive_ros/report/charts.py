"""Shapes of the report's charts, in SVG units; the template draws them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

# Okabe and Ito's palette, in an order that keeps neighbours apart for every kind of colour vision.
PALETTE = ('#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#D55E00', '#F0E442', '#5A5A5A')
MAX_RUNS = len(PALETTE)
WIDTH, HEIGHT = 1040, 300
LEFT, TOP, BOTTOM = 44, 18, 46
GROUP_FILL = 0.84
MAX_BAR = 26.0
VALUES_UP_TO = 5


@dataclass(frozen=True, slots=True)
class Bar:
    """One driver's bar in one group. low_y, high_y: ends of the interval's whisker, or None."""

    x: float
    y: float
    width: float
    height: float
    colour: str
    letter: str
    mean: float
    low_y: float | None
    high_y: float | None


@dataclass(frozen=True, slots=True)
class Group:
    title: str
    x: float
    bars: tuple[Bar, ...]


@dataclass(frozen=True, slots=True)
class Chart:
    """grid: (y, percent). show_values: there is room for a number on every bar."""

    width: int
    height: int
    left: int
    base_y: float
    grid: tuple[tuple[float, int], ...]
    groups: tuple[Group, ...]
    show_values: bool


def _y(percent: float) -> float:
    return round(TOP + (HEIGHT - TOP - BOTTOM) * (1.0 - percent / 100.0), 1)


def grouped_bars(titles: Sequence[str], series: Sequence[dict[str, dict[str, Any]]]) -> Chart:
    """One group per title; series: per driver, title -> {mean, low?, high?} in percent (a title may be absent)."""
    step = (WIDTH - LEFT) / max(len(titles), 1)
    width = min(MAX_BAR, GROUP_FILL * step / len(series))
    groups = []
    for i, title in enumerate(titles):
        middle = LEFT + (i + 0.5) * step
        first = middle - width * len(series) / 2
        bars = []
        for j, values in enumerate(series):
            if title in values:
                value = values[title]
                ends = (_y(value['low']), _y(value['high'])) if 'low' in value else (None, None)
                top = _y(value['mean'])
                bar = (round(first + j * width + 1, 1), top, round(width - 2, 1), round(_y(0) - top, 1))
                bars.append(Bar(*bar, PALETTE[j], chr(ord('A') + j), value['mean'], *ends))
        groups.append(Group(title, round(middle, 1), tuple(bars)))
    grid = tuple((_y(percent), percent) for percent in (0, 25, 50, 75, 100))
    return Chart(WIDTH, HEIGHT, LEFT, _y(0), grid, tuple(groups), len(series) <= VALUES_UP_TO)
