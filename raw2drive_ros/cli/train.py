"""raw2drive train: both stages, from bags only."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

EXAMPLES = """examples:
  raw2drive train privileged --bags runs/bags --run runs/stage1 --steps 6000
  raw2drive train raw --bags runs/bags --run runs/stage2 --teacher runs/stage1 --steps 3000 --export runs/bundle
  raw2drive train privileged --preset nano --steps 20 --bags bags --run runs/try    (seconds)
  raw2drive train raw ... --set weight_stoch=0    (an ablation: no stochastic alignment)

Called again with the same --run it goes on where it stopped, also after a kill."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('stage', choices=('privileged', 'raw'))
    parser.add_argument('--bags', type=Path, nargs='+', required=True, help='bags, or folders of bags')
    parser.add_argument('--run', dest='training_run', type=Path, required=True, help='run folder')
    parser.add_argument('--steps', type=int, default=6000, help='gradient steps in all')
    parser.add_argument('--preset', default='laptop', help='nano, laptop or paper')
    parser.add_argument('--teacher', type=Path, help='stage-1 run (stage raw)')
    parser.add_argument('--cache', type=Path, default=Path('runs/cache'), help='where bags are unpacked to')
    parser.add_argument('--export', type=Path, help='write a policy bundle here at the end (stage raw)')
    parser.add_argument('--set', action='append', default=[], metavar='FIELD=VALUE', help='override a training field')


def _overrides(pairs: list[str]) -> dict[str, Any]:
    import yaml

    from raw2drive_ros.cli.errors import UsageError

    found = {}
    for pair in pairs:
        name, equals, value = pair.partition('=')
        if not equals:
            raise UsageError(f'--set {pair}: use FIELD=VALUE')
        found[name] = yaml.safe_load(value)
    return found


def run(options: argparse.Namespace) -> int:
    import os

    # Before torch allocates anything: huge pages halve the cost of large elementwise kernels.
    os.environ.setdefault('THP_MEM_ALLOC_ENABLE', '1')
    from raw2drive_ros.cli.errors import UsageError
    from raw2drive_ros.cli.progress import bar
    from raw2drive_ros.training.run import train

    if options.stage == 'raw' and options.teacher is None:
        raise UsageError('stage raw needs --teacher RUN, the folder of a stage-1 run')
    if options.stage == 'privileged' and options.export is not None:
        raise UsageError('--export makes a bundle of the raw policy; it goes with stage raw')
    with bar(f'training {options.stage}', options.steps, 'steps') as advance:

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
        )
    print(f'{trainer.steps} steps in {options.training_run} (metrics.jsonl, pictures/, tensorboard/)')
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
