"""raw2drive attack: strangers, lies, replays and kills against a real graph; does the car stand, and is it logged?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from raw2drive_ros.cli.domain_option import domain_id

if TYPE_CHECKING:
    from raw2drive_ros.graph.attack import Outcome

EXAMPLES = """examples:
  raw2drive attack                          every attack, about ten minutes
  raw2drive attack --list                   only their names
  raw2drive attack --only commands          those whose name contains the word
  raw2drive attack --seed 1 --json          other moments, speeds and values; the table as JSON

Bridge (real time), planner and gate run on this machine; each attack begins on a car that drives. The table says how
fast the car became afterwards, when it stood, when it had to, and what was logged. Exit code 1 when an attack was not
survived: the car did not stand in time, started again by itself, or nobody logged why."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--only', default='', help='attacks whose name contains this')
    parser.add_argument('--list', action='store_true', help='print the names and end')
    parser.add_argument('--seed', type=int, default=0, help='of moments, steering and rates (0)')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--out', type=Path, default=Path('runs/attack'), help='folder of the logs')
    # Not ROS_DOMAIN_ID: in a robot's own domain its car would be attacked too.
    parser.add_argument(
        '--domain',
        type=domain_id,
        help='ROS domain (default: the first free one from 50 on, whatever ROS_DOMAIN_ID is)',
    )
    parser.add_argument('--json', action='store_true', help='print the outcomes as JSON lines')


def run(options: argparse.Namespace) -> int:
    import json
    import shutil
    import sys
    from dataclasses import asdict

    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.graph.attack import run_attacks
    from raw2drive_ros.graph.attacks import attacks
    from raw2drive_ros.graph.processes import reserve_domain
    from raw2drive_ros.progress import bar
    from raw2drive_ros.settings import default_bundle

    chosen = [attack for attack in attacks() if options.only in attack.name]
    if not chosen:
        raise UsageError(f'--only {options.only}: no attack is called so; see raw2drive attack --list')
    if options.list:
        print('\n'.join(attack.name for attack in chosen))
        return 0
    bundle = (options.bundle or default_bundle()).resolve()
    load_bundle(bundle)
    logs = options.out / 'logs'
    shutil.rmtree(logs, ignore_errors=True)
    done: list[Outcome] = []
    try:
        with reserve_domain(options.domain) as domain, bar('attack', len(chosen), 'attacks') as advance:

            def on_outcome(outcome: Outcome) -> None:
                done.append(outcome)
                advance(len(done), outcome.attack)

            run_attacks(logs, domain, bundle, chosen, options.seed, on_outcome)
    finally:
        # Also where the graph fails, or at Ctrl-C: what was measured so far.
        if options.json:
            print('\n'.join(json.dumps(asdict(outcome) | {'passed': outcome.passed}) for outcome in done))
        elif done:
            _print(done)
    survived = sum(outcome.passed for outcome in done)
    print(f'{survived} of {len(done)} attacks survived; logs in {logs}', file=sys.stderr)
    return 0 if survived == len(done) else 1


def _print(found: list[Outcome]) -> None:
    """A table in Markdown, as docs/reliability.md has it; whole lines, also when piped."""
    print('| attack | m/s before | largest after | stands after (s) | allowed (s) | | logged |')
    print('|---|---|---|---|---|---|---|')
    for each in found:
        stand = 'never' if each.stand_s is None else f'{each.stand_s:.1f}'
        verdict = 'survived' if each.passed else 'drove off again' if each.moved_again else 'FAILED'
        print(
            f'| {each.attack} | {each.before_mps:.1f} | {each.largest_mps:.1f} | {stand} | {each.allowed_s:.1f} '
            f'| {verdict} | {each.logged.replace("|", "/")[:160]} |'
        )
