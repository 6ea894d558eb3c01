"""raw2drive suite: list, show, draw, compare and attack the suites."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from raw2drive_ros.cli.parser import at_least, refuse_all_but

EXAMPLES = """examples:
  raw2drive suite list
  raw2drive suite show dev10                           its routes: type, seed, weather, abilities, time limit
  raw2drive suite show b2d220 --json
  raw2drive suite build b2d220 --version 3 --workers 2 --out params/suites/b2d220.json
  raw2drive suite distance b2d220 train                how near is the nearest training scene to each route?
  raw2drive suite tune train --workers 2 --out params/sightless
  raw2drive suite audit b2d220 --workers 2 --out runs/audit.jsonl
  raw2drive suite audit b2d220 --search --types Accident,T_Junction

build draws pairs of an event and its twin. It rejects draws whose actors crash among themselves before the ego is
involved, that no reference driver completes, or that are too like another one; each drive gets 1.25 times the
reference driver's time plus 5 s. The same command goes on where it was interrupted.

distance fails (exit code 1) for duplicates and near-copies. tune chooses on training routes how each sightless driver
drives on each type; audit drives them over a suite and fails when they win too many pairs of it. Types for which
nothing was chosen, or with --search all of them, are tuned first."""

READS = {
    'list': ('action',),
    'show': ('action', 'name', 'json'),
    'build': ('action', 'name', 'version', 'out', 'reference', 'fallback', 'workers'),
    'distance': ('action', 'name', 'other', 'json'),
    'tune': ('action', 'name', 'out', 'reference', 'fallback', 'workers', 'types', 'pairs'),
    'audit': (
        *('action', 'name', 'out', 'reference', 'fallback', 'workers', 'types', 'pairs'),
        *('train', 'choices', 'drivers', 'search', 'hindsight', 'json'),
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=tuple(READS))
    parser.add_argument('name', nargs='?', help='of a suite, see raw2drive suite list, or a .json file')
    parser.add_argument('other', nargs='?', help='the suite to compare with (distance)')
    parser.add_argument('--version', default='3', help='version that the file carries (build)')
    parser.add_argument('--out', type=Path, help='file to write (build), folder (tune), a JSON line per pair (audit)')
    parser.add_argument(
        '--reference', default='expert', help="driver that sets the limits (build, tune, audit's search)"
    )
    parser.add_argument('--fallback', default='oracle', help="where the reference does not reach the goal; '': none")
    parser.add_argument('--workers', type=int, default=1, help='processes that drive at the same time')
    parser.add_argument('--types', help='comma list of scenario types instead of all (tune, audit)')
    parser.add_argument('--pairs', type=int, default=5, help='training routes per type (tune, audit)')
    parser.add_argument('--train', default='train', help='suite that the search may see (audit)')
    parser.add_argument('--choices', type=Path, help='folder that tune has written (audit; default: the shipped one)')
    parser.add_argument('--drivers', help='comma list of sightless drivers instead of all (audit)')
    parser.add_argument('--search', action='store_true', help='tune anew on training routes first (audit)')
    parser.add_argument(
        '--hindsight', action='store_true', help='also: does any speed profile win, chosen on the pair itself? (audit)'
    )
    parser.add_argument('--json', action='store_true', help='print as JSON (show, distance, audit)')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli import suite_tools

    refuse_all_but(options, READS[options.action], f'suite {options.action}')
    at_least(options, 1, 'workers', 'pairs')
    verbs = {
        'list': _list,
        'show': _show,
        'build': suite_tools.build,
        'distance': suite_tools.compare,
        'tune': suite_tools.tune_drivers,
        'audit': suite_tools.audit_suite,
    }
    return verbs[options.action](options)


def _list(options: argparse.Namespace) -> int:
    from raw2drive_ros.evaluation.suites import load_suite, suite_names

    for name in suite_names():
        suite = load_suite(name)
        types, twins = len({route.type for route in suite.routes}), sum(route.twin for route in suite.routes)
        also = f', {twins} of them twins' if twins else ''
        limits = ', with time limits' if suite.timings else ''
        print(
            f'{suite.name:12s} version {suite.version:4s} {len(suite.routes):5d} routes of {types} types{also}{limits}'
        )
    return 0


def _show(options: argparse.Namespace) -> int:
    """Every route of a suite, in the order in which it is driven."""
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.suites import load_suite, suite_names
    from raw2drive_ros.simulation.scenario import load_scenarios

    if options.name is None:
        raise UsageError(f'suite show needs a name: {", ".join(suite_names())}, or a .json file')
    suite, known = load_suite(options.name), load_scenarios()
    routes = [
        {
            'route': str(r),
            'type': r.type,
            'seed': r.seed,
            'twin': r.twin,
            'weather': r.weather,
            'abilities': known[r.type].abilities,
            'limit_s': suite.limit_s(r),
            'reference_s': suite.reference_s(r),
        }
        for r in suite.routes
    ]
    if options.json:
        print(json.dumps({'suite': suite.name, 'version': suite.version, 'routes': routes}))
        return 0
    table = Table(title=f'{suite.name} version {suite.version}: {len(routes)} routes')
    columns = ('type', 'seed', 'weather', 'abilities', 'drive', 'limit s')
    for column in columns:
        add_column(table, column, right=column in ('seed', 'limit s'))
    for r in suite.routes:
        abilities, limit_s = ', '.join(known[r.type].abilities) or '-', suite.limit_s(r)
        drive, shown = 'twin' if r.twin else 'event', '-' if limit_s is None else f'{limit_s:.1f}'
        table.add_row(r.type, str(r.seed), r.weather, abilities, drive, shown)
    wide_console().print(table)
    print(f'drive them: raw2drive evaluate --suite {options.name}')
    return 0
