"""raw2drive dream: what a privileged world model believes and imagines at a moment of a bag."""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """examples:
  raw2drive dream runs/bags/expert/expert_100000 --at 12.5 --run runs/stage1
  raw2drive dream runs/demo/bag --at 20 --seconds 5 --run runs/stage1 --own-actions --out dream.mp4

The video shows truth, posterior (green) and, from --at on, imagination (red): masks, and reward and continue
as recorded (white), read from the posterior (green) and imagined (red). An imagination drifts: the overlap (IoU) of
its masks with the true ones is printed and shown, beside that of the posterior, which goes on seeing."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path)
    parser.add_argument('--at', type=float, required=True, help='seconds after the first tick of the bag')
    parser.add_argument('--seconds', type=float, default=3.0, help='how long to imagine')
    parser.add_argument('--run', dest='training_run', type=Path, help='run, checkpoint or teacher (default: shipped)')
    parser.add_argument(
        '--own-actions', action='store_true', help="imagine the policy's actions, not the recorded ones"
    )
    parser.add_argument('--out', type=Path, default=Path('dream.mp4'), help='MP4 to write')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.report.dream import dream, overlaps, reasons_of, save_dream, ticks_around
    from raw2drive_ros.settings import default_teacher
    from raw2drive_ros.world_model.teacher import load_teacher

    if options.at < 0 or options.seconds <= 0:
        raise UsageError('--at: give 0 or more; --seconds: more than 0')
    if options.out.suffix.lower() != '.mp4':
        raise UsageError(f'--out {options.out}: give a name that ends in .mp4')
    if options.training_run is None and not default_teacher().is_dir():
        raise UsageError(f'give --run: the shipped teacher is not at {default_teacher()}')
    teacher = load_teacher(options.training_run or default_teacher())
    ticks, begins = ticks_around(options.bag, options.at, options.seconds, teacher.config)
    found = dream(teacher, ticks, begins, own_actions=options.own_actions)
    found.reasons = reasons_of(options.bag, ticks)
    print(f'{save_dream(options.out, found, list(teacher.config.mask_classes))}: {ticks[begins].episode}')
    imagined, posterior = (overlaps(found, name) for name in ('imagined', 'posterior'))
    shown = sorted({after for after in (0.5, 1.0, 2.0, 4.0, 8.0) if after < max(imagined)} | {max(imagined)})
    told = ', '.join(f'{imagined[after]:.2f} (posterior {posterior[after]:.2f}) after {after:g} s' for after in shown)
    print(f'overlap of the imagined masks with the true ones: {told}')
    return 0
