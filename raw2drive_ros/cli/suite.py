"""raw2drive suite: list the suites, or draw one anew."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from raw2drive_ros.cli.parser import refuse_all_but

EXAMPLES = """examples:
  raw2drive suite list
  raw2drive suite show dev10                           its routes: type, seed, weather, abilities
  raw2drive suite show b2d220 --json
  raw2drive suite build b2d220 --version 2 --out params/suites/b2d220.json

A draw is rejected when actors crash among themselves before the ego is involved; the rate is printed."""

READS = {'list': ('action',), 'show': ('action', 'name', 'json'), 'build': ('action', 'name', 'version', 'out')}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('list', 'show', 'build'))
    parser.add_argument('name', nargs='?', help='b2d220, dev10, long, validation or train; show: or a .json file')
    parser.add_argument('--version', default='2', help='version that the file carries')
    parser.add_argument('--out', type=Path, help='file to write (build)')
    parser.add_argument('--json', action='store_true', help='print the routes as JSON (show)')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.contracts.near_names import did_you_mean
    from raw2drive_ros.evaluation.suites import draw_suite, load_suite, suite_names, suite_plans
    from raw2drive_ros.progress import bar

    refuse_all_but(options, READS[options.action], f'suite {options.action}')
    if options.action == 'show':
        return _show(options)
    if options.action == 'list':
        for name in suite_names():
            suite = load_suite(name)
            types = len({route.type for route in suite.routes})
            print(f'{suite.name:12s} version {suite.version:4s} {len(suite.routes):5d} routes of {types} types')
        return 0
    plans = suite_plans()
    if options.name not in plans or options.out is None:
        near = did_you_mean(options.name or '', plans)
        raise UsageError(f'suite build needs one of {", ".join(plans)} and --out FILE{near}')
    plan = plans[options.name]
    total = plan.per_type * len(plan.types)
    with bar(f'drawing {options.name}', total, 'routes') as advance:
        routes, rejected = draw_suite(plan, advance)
    lines = ',\n'.join(f'    {json.dumps(kind)}: {json.dumps(places)}' for kind, places in routes.items())
    head = f'"name": {json.dumps(options.name)}, "version": {json.dumps(options.version)}'
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(f'{{\n  {head},\n  "routes": {{\n{lines}\n  }}\n}}\n')
    share = 100.0 * rejected / (total + rejected)
    print(f'{options.out}: {total} routes; {rejected} of {total + rejected} draws rejected ({share:.1f} %)')
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
        {'route': str(r), 'type': r.type, 'seed': r.seed, 'weather': r.weather, 'abilities': known[r.type].abilities}
        for r in suite.routes
    ]
    if options.json:
        print(json.dumps({'suite': suite.name, 'version': suite.version, 'routes': routes}))
        return 0
    table = Table(title=f'{suite.name} version {suite.version}: {len(routes)} routes')
    for column in ('type', 'seed', 'weather', 'abilities'):
        add_column(table, column, right=column == 'seed')
    for route in routes:
        abilities = ', '.join(route['abilities']) or '-'
        table.add_row(route['type'], str(route['seed']), route['weather'], abilities)
    wide_console().print(table)
    print(f'drive them: raw2drive evaluate --suite {options.name}')
    return 0
