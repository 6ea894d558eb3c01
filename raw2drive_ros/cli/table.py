"""Results and events as tables in the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from raw2drive_ros.recording.events import Event


# Wide enough for a row of any table: what is piped is read by programs, or by people in an editor.
PIPED_COLUMNS = 1000
# Printed where there are pairs of drives.
PAIR_SCORES = ('pair_success_rate', 'event_success_rate', 'twin_success_rate', 'needless_stops', 'time_lost_s')


def wide_console() -> Console:
    """A console as wide as the terminal; into a file or a pipe, every row of a table is one whole line."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPED_COLUMNS)


def add_column(table: Table, title: str, *, right: bool = False) -> None:
    """A column whose cells go on in the next line where the terminal is narrow: no name and no figure is cut."""
    table.add_column(title, justify='right' if right else 'left', overflow='fold')


def print_results(result: dict[str, Any]) -> None:
    """Route rows, then means with 95 % intervals, then timing."""
    from rich.table import Table

    console = wide_console()
    table = Table(title=f'{result["driver"]} on {result["suite"]}')
    for column in ('route', 'completion %', 'infractions', 'driving score', 'success'):
        add_column(table, column, right=column not in ('route', 'infractions'))
    for row in result['routes']:
        events = ', '.join(f'{name} x{count}' for name, count in row['infractions'].items()) or '-'
        table.add_row(
            row['id'],
            f'{row["route_completion"]:.1f}',
            events,
            f'{row["driving_score"]:.1f}',
            'yes' if row['success'] else 'no',
        )
    console.print(table)
    summary = result['summary']
    for name in (*PAIR_SCORES, 'driving_score', 'success_rate', 'route_completion', 'efficiency', 'comfort'):
        value = summary[name]
        title = name.replace('_', ' ')
        if value is None and name in PAIR_SCORES:
            continue
        if value is None:
            console.print(f'{title}: undefined on every route')
            continue
        defined = f', defined on {summary["defined"][name]}' if name in summary['defined'] else ''
        console.print(f'{title}: {value["mean"]:.1f} (95 %: {value["low"]:.1f} to {value["high"]:.1f}){defined}')
    for name, value in result.get('abilities', {}).items():
        interval = f' (95 %: {value["low"]:.0f} to {value["high"]:.0f})' if 'low' in value else ''
        console.print(f'ability {name}: {value["mean"]:.1f}{interval}')
    if result['missing']:
        console.print(f'missing, counted as zero: {", ".join(result["missing"])}')
    if result['flaky']:
        names = ', '.join(f'{r["type"]}/{r["seed"]} ({r["successes"]} of {r["drives"]})' for r in result['flaky'])
        console.print(f'flaky: {names}')
    done = sum(row['route_completion'] >= 90 for row in result['routes'])
    console.print(f'{done} of {len(result["routes"])} routes with completion >= 90 %')
    timing = result['timing']
    if timing['ticks_per_s'] is None:
        # Every route was driven by an earlier call.
        return
    line = f'{timing["ticks_per_s"]} ticks/s, tick p50 {timing["tick_ms"]["p50"]} ms, p99 {timing["tick_ms"]["p99"]} ms'
    if 'planner_ms' in timing:
        planner = timing['planner_ms']
        line += f'; planner p50 {planner["p50"]:.1f} ms, p99 {planner["p99"]:.1f} ms'
    console.print(line + f'; messages lost: {timing["messages_lost"]}')


def print_events(events: Sequence[Event]) -> None:
    """One line per event; the text of nodes is printed literally, without markup."""
    from rich.text import Text

    from raw2drive_ros.contracts.texts import shown

    console = wide_console()
    colours = {'ok': 'green', 'warning': 'yellow', 'error': 'red', 'stale': 'red'}
    for event in events:
        line = Text(f'{event.time_s:8.1f} s  ').append(f'{event.level:8}', colours[event.level])
        console.print(line.append(f'{shown(event.node):15} {shown(event.text)}'), soft_wrap=True)
