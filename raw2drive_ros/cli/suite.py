"""raw2drive suite: list the suites, or draw one anew."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

EXAMPLES = """examples:
  raw2drive suite list
  raw2drive suite build b2d220 --version 2 --out params/suites/b2d220.json

A draw is rejected when actors crash among themselves before the ego is involved; the rate is printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('list', 'build'))
    parser.add_argument('name', nargs='?', help='b2d220, dev10, long, validation or train (build)')
    parser.add_argument('--version', default='2', help='version that the file carries')
    parser.add_argument('--out', type=Path, help='file to write (build)')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.suites import draw_suite, load_suite, suite_folder, suite_plans
    from raw2drive_ros.progress import bar

    if options.action == 'list':
        for path in sorted(suite_folder().glob('*.json')):
            suite = load_suite(path.stem)
            types = len({route.type for route in suite.routes})
            print(f'{suite.name:12s} version {suite.version:4s} {len(suite.routes):5d} routes of {types} types')
        return 0
    plans = suite_plans()
    if options.name not in plans or options.out is None:
        raise UsageError(f'suite build needs one of {", ".join(plans)} and --out FILE')
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
