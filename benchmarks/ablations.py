"""What each part of the teacher's recipe contributes: one change at a time, on the same bags, scored on validation.

Every variant is trained from nothing on the bags that a run of the recipe collected (`raw2drive train privileged`) with
the same number of steps and the same random draws, then drives the suite `validation`. Finished variants are not
repeated; an interrupted one is resumed. `base_seed1` is the base with other random draws: differences of its size are
chance.

python -m benchmarks.ablations --bags runs/teacher/bags --out runs/ablations [--steps 2000] [--only base reset ...]

On two cores, two of these commands with --threads 1 and different variants finish sooner than one with two threads.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from raw2drive_ros.evaluation.results import Results, read_results
from raw2drive_ros.evaluation.statistics import compare, summary
from raw2drive_ros.training.recipe import load_recipe
from raw2drive_ros.world_model.run_files import checkpoint_of

SUITE = 'validation'


class Variant(NamedTuple):
    """set: training fields that differ from the base. without: pattern of the folders of bags that are left out."""

    about: str
    set: dict[str, Any]
    without: str = ''


HALF_WAY = 'half way'
VARIANTS = {
    'base': Variant("the recipe's settings", {}),
    'base_seed1': Variant('other draws', {'seed': 1}),
    'no_expert_bags': Variant('without the bags that the expert drove', {}, '*_expert'),
    'no_imitation': Variant('reinforcement in imagination alone', {'imitate': 0.0}),
    'no_advice_head': Variant("no world-model head that predicts the expert's advice", {'weight_advice': 0.0}),
    'no_terminal_priority': Variant('sequences drawn evenly', {'terminal_share': 0.0}),
    'reset': Variant('fresh policy half way', {'reset_policy_at': HALF_WAY}),
}


def train(name: str, options: argparse.Namespace, run: Path) -> None:
    """Train one variant, or resume it; a finished one is left as it is."""
    variant, recipe = VARIANTS[name], load_recipe(options.recipe)
    fields = recipe.set | {'decay_share': 0.25, 'checkpoint_every': 250, 'threads': options.threads} | variant.set
    fields = {name: options.steps // 2 if value == HALF_WAY else value for name, value in fields.items()}
    left_out = set(options.bags.glob(variant.without)) if variant.without else set()
    bags = sorted(path for path in options.bags.iterdir() if path.is_dir() and path not in left_out)
    command = ['train', 'privileged', '--run', str(run), '--steps', str(options.steps), '--preset', recipe.preset]
    command += ['--cache', str(options.cache), '--bags', *map(str, bags)]
    for field, value in fields.items():
        command += ['--set', f'{field}={value}']
    call(command)


def drive(run: Path, results: Path, workers: int) -> Results:
    """Drive the suite with the newest checkpoint; rows of routes that were driven already are kept."""
    newest = checkpoint_of(run)
    command = ['evaluate', '--driver', 'privileged', '--run', str(newest), '--suite', SUITE, '--workers', str(workers)]
    call([*command, '--out', str(results), '--json'])
    return read_results(results)


def call(arguments: list[str]) -> None:
    """Run a verb of `raw2drive` in a process of its own. Raises CalledProcessError."""
    subprocess.run([sys.executable, '-m', 'raw2drive_ros.cli.main', *arguments], check=True, stdout=subprocess.DEVNULL)


def interval(value: dict[str, float]) -> str:
    """A mean with its 95 % interval, for a cell of the table."""
    return f'{value["mean"]:.1f} ({value["low"]:.1f} to {value["high"]:.1f})'


def main() -> int:
    """Train and drive the chosen variants; print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--bags', type=Path, required=True, help="the bags of a recipe's run")
    parser.add_argument('--out', type=Path, default=Path('runs/ablations'), help='one run per variant, and its results')
    parser.add_argument('--cache', type=Path, default=Path('runs/cache'), help='where bags are unpacked to')
    parser.add_argument('--recipe', default='teacher', help='whose settings are the base')
    parser.add_argument('--steps', type=int, default=2000, help='gradient steps of every variant')
    parser.add_argument('--threads', type=int, default=2, help='of training, and processes that drive')
    parser.add_argument('--only', nargs='+', choices=VARIANTS, default=list(VARIANTS), help='variants')
    options = parser.parse_args()
    found: dict[str, Results] = {}
    for name in options.only:
        print(f'{name}: {VARIANTS[name].about}', file=sys.stderr)
        run = options.out / name
        train(name, options, run)
        found[name] = drive(run, options.out / f'{name}.jsonl', options.threads)
    print('| variant | what changed | driving score | success % | difference of driving score | |\n' + '|---' * 6 + '|')
    for name, results in found.items():
        s = summary(results)
        line = f'| {name} | {VARIANTS[name].about} | {interval(s["driving_score"])} | {interval(s["success_rate"])} |'
        if name != 'base' and 'base' in found:
            told = compare(found['base'], results)['driving_score']
            line += f' {interval(told)} | {told["verdict"]} |'
        else:
            line += ' | |'
        print(line, flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
