"""raw2drive train: both stages, from bags only."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.parser import at_least, note, refuse

EXAMPLES = """examples:
  raw2drive train privileged --bags runs/bags --run runs/stage1 --steps 6000
  raw2drive train privileged --recipe teacher --run runs/teacher --export params/bundles/teacher    (hours)
  raw2drive train raw --bags runs/bags --run runs/stage2 --teacher runs/stage1 --steps 3000 --export runs/bundle
  raw2drive train privileged --preset nano --steps 20 --bags bags --run runs/try    (seconds)
  torchrun --nproc-per-node 4 -m raw2drive_ros.cli.main train privileged --bags runs/bags --folder runs/stage1
  raw2drive train raw ... --set weight_stoch=0    (an ablation: no stochastic alignment)
  raw2drive train privileged --preset nano --set seed=3 --show-config    (every field, and where it comes from)
  raw2drive train privileged --set help    (the fields of --set)

Called again with the same --run it goes on where it stopped, also after a kill. Ctrl-C finishes the step and writes a
checkpoint first."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('stage', choices=('privileged', 'raw'))
    parser.add_argument('--bags', type=Path, nargs='+', help='bags, or folders of bags')
    parser.add_argument(
        '--recipe', help='instead of --bags and --steps: rounds of collecting and training (params/recipes, or a file)'
    )
    parser.add_argument('--workers', type=int, default=2, help='--recipe: processes that collect or validate at a time')
    parser.add_argument(
        '--run',
        '--folder',
        dest='training_run',
        type=Path,
        help='run folder (torchrun takes --run for its own)',
    )
    parser.add_argument('--steps', type=int, default=6000, help='gradient steps in all')
    parser.add_argument('--preset', help='of a new run: nano, laptop (default), laptop_flat or paper')
    parser.add_argument('--teacher', type=Path, help='stage-1 run, checkpoint or teacher bundle (stage raw)')
    parser.add_argument('--cache', type=Path, default=Path('runs/cache'), help='where bags are unpacked to')
    parser.add_argument('--export', type=Path, help='write a bundle of the policy (of the teacher) here at the end')
    parser.add_argument(
        '--set', action='append', default=[], metavar='FIELD=VALUE', help='a training field; --set help lists them'
    )
    parser.add_argument('--show-config', action='store_true', help='print the whole configuration and train nothing')


def _overrides(pairs: list[str]) -> dict[str, Any]:
    import yaml

    from raw2drive_ros.contracts.errors import UsageError

    found = {}
    for pair in pairs:
        name, equals, value = pair.partition('=')
        if not equals:
            raise UsageError(f'--set {pair}: use FIELD=VALUE; --set help lists the fields')
        found[name] = yaml.safe_load(value)
    return found


def run(options: argparse.Namespace) -> int:
    import os

    # Before torch allocates anything: huge pages halve the cost of large elementwise kernels.
    os.environ.setdefault('THP_MEM_ALLOC_ENABLE', '1')
    # Waiting threads that spin for long take the cores from the working ones as soon as anything else runs: ten times
    # slower beside a collector. Waiting threads that sleep at once cost a third of the speed. So they spin for some
    # tens of microseconds and then sleep.
    os.environ.setdefault('OMP_WAIT_POLICY', 'PASSIVE')
    os.environ.setdefault('GOMP_SPINCOUNT', '30000')
    from raw2drive_ros.progress import bar
    from raw2drive_ros.training.parallel import ranks_of_torchrun
    from raw2drive_ros.training.run import train

    if 'help' in options.set or options.show_config:
        return _show(options)
    _check(options)
    if options.recipe is not None:
        return _run_recipe(options)
    with ranks_of_torchrun() as ranks, bar(f'training {options.stage}', options.steps, 'steps') as advance:

        def report(step: int, metrics: dict[str, float]) -> None:
            shown = ('loss/masks', 'loss/align_stoch', 'loss/reward', 'policy/reward', 'policy/entropy')
            note = ' '.join(f'{k.split("/")[1]} {metrics[k]:.3g}' for k in shown if k in metrics)
            advance(step, note)

        trainer = train(
            options.stage,
            options.training_run,
            options.bags,
            options.cache,
            options.steps,
            options.preset,
            _overrides(options.set),
            options.teacher,
            report=report,
            ranks=ranks,
        )
    if not ranks.leads:
        return 0
    if trainer.steps > options.steps:
        note(f'nothing to train: the run has more steps than --steps {options.steps}, their number in all')
    print(f'{trainer.steps} steps in {options.training_run} (metrics.jsonl, pictures/, tensorboard/)')
    if options.export is not None and options.stage == 'privileged':
        return _export_teacher(options)
    if options.export is not None:
        from raw2drive_ros.training.export import export_bundle

        identity = export_bundle(options.training_run, options.export)
        print(f'bundle {identity} in {options.export}')
        print(f'next: raw2drive evaluate --driver raw --bundle {options.export} --routes lane-following --seeds 20')
    elif options.stage == 'raw':
        print('next: the same command with --export DIR makes a policy bundle')
    else:
        print(f'next: raw2drive evaluate --driver privileged --run {options.training_run} --routes lane-following')
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raises UsageError for what is missing, and for options that would be without effect."""
    from raw2drive_ros.contracts.errors import UsageError

    at_least(options, 1, 'workers', 'steps')
    if options.training_run is None:
        raise UsageError('give --run, the folder of the run')
    if options.stage == 'raw' and options.teacher is None:
        raise UsageError('stage raw needs --teacher RUN, the folder of a stage-1 run')
    if options.stage == 'privileged':
        refuse(options, ['teacher'], 'is for stage raw; stage privileged learns without one')
    if options.recipe is not None:
        refuse(options, ['steps', 'preset'], 'is fixed by --recipe')
        if options.stage != 'privileged' or options.bags is not None:
            raise UsageError('--recipe collects its own bags, for stage privileged')
        return
    refuse(options, ['workers'], 'goes with --recipe')
    if options.bags is None:
        raise UsageError('give --bags, or a --recipe that collects them')


def _show(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli.train_config import print_config, print_fields
    from raw2drive_ros.training.recipe import load_recipe

    if 'help' in options.set:
        print_fields()
        return 0
    recipe = None
    if options.recipe is not None:
        refuse(options, ['preset'], 'is fixed by --recipe')
        recipe = load_recipe(options.recipe)
    print_config(options.training_run, options.preset, _overrides(options.set), recipe)
    return 0


def _run_recipe(options: argparse.Namespace) -> int:
    from raw2drive_ros.evaluation.recipe_rounds import run_recipe
    from raw2drive_ros.training.recipe import load_recipe

    recipe = load_recipe(options.recipe)
    run_recipe(recipe, options.training_run, options.cache, _overrides(options.set), options.workers)
    if options.export is not None:
        return _export_teacher(options)
    print(f'next: raw2drive evaluate --driver privileged --run {options.training_run} --suite b2d220 --workers 2')
    return 0


def _export_teacher(options: argparse.Namespace) -> int:
    from raw2drive_ros.training.export import export_teacher

    identity = export_teacher(options.training_run, options.export)
    print(f'teacher {identity} in {options.export}')
    print(f'next: raw2drive evaluate --driver privileged --run {options.export} --suite b2d220 --workers 2')
    return 0
