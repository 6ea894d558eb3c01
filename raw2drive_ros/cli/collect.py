"""raw2drive collect: training bags without a graph."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.driver_options import refuse_for_drivers
from raw2drive_ros.cli.parser import at_least, note, refuse
from raw2drive_ros.evaluation.drivers import DRIVERS, driver_entry, driver_help, driver_list
from raw2drive_ros.simulation.weather import CLEAR, WEATHER_NAMES, get_weather

EXAMPLES = """examples:
  raw2drive collect --driver rule --noise 0.06 --ticks 30000 --out runs/bags/rule
  raw2drive collect --driver expert --table --routes all --no-cameras --ticks 40000 --out runs/bags/expert
  raw2drive collect --driver privileged --run runs/stage1 --noise 0.05 --ticks 8000 --seed 1 --out runs/bags/policy1
  raw2drive collect --driver privileged --run runs/stage1 --advice --routes all --no-cameras --out runs/bags/policy2
  raw2drive collect --driver expert --table --routes 'all,ParkedObstacle*3' --no-cameras --out runs/bags/parked

The bags hold the same topics as those of `raw2drive record`. After Ctrl-C or a kill the same command goes on."""
EXAMPLES += f'\n\n{driver_list()}'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--driver', default='rule', help=driver_help())
    parser.add_argument('--run', dest='training_run', type=Path, help='run, checkpoint or teacher that drives')
    parser.add_argument('--bundle', type=Path, help='policy bundle of driver raw')
    parser.add_argument(
        '--routes',
        default='lane-following',
        help='scenario types, abilities or all, comma separated; TYPE*3 counts three times',
    )
    parser.add_argument('--ticks', type=int, default=20_000, help='decision ticks to write (10 per second)')
    parser.add_argument('--episode-ticks', type=int, default=400, help='cut every episode after so many ticks')
    parser.add_argument('--stand-ticks', type=int, default=0, help='and when the car has stood for so many (0: never)')
    parser.add_argument('--noise', type=float, default=0.0, help='chance per tick of a burst of random actions')
    parser.add_argument(
        '--table', action='store_true', help="turn the driver's commands into actions of the policy's table of 39"
    )
    parser.add_argument(
        '--advice', action='store_true', help='also write what the expert would do in the same state (as DAgger asks)'
    )
    parser.add_argument(
        '--advice-every',
        type=int,
        default=4,
        metavar='N',
        help='ask the expert at 4 ticks in a row out of N (4: always)',
    )
    parser.add_argument('--seed', type=int, default=0, help='0 or more; another one draws other training routes')
    parser.add_argument('--weather', default=CLEAR, help='a weather preset, or cycle: one of all presets every episode')
    parser.add_argument(
        '--twins',
        type=float,
        default=1.0 / 3.0,
        help='share of twins, in which nothing happens, of types that have one',
    )
    parser.add_argument('--vary', action='store_true', help='vary camera, mounting, paint and sun between episodes')
    parser.add_argument('--size', default='96x160', help='camera images: 96x160, 224x400 or 64x96')
    parser.add_argument('--no-cameras', action='store_true', help='leave the images out (stage 1 does not need them)')
    parser.add_argument('--out', type=Path, required=True, help='folder that the bags go to')


def run(options: argparse.Namespace) -> int:
    import cv2
    import torch

    from raw2drive_ros.evaluation.collect import CollectConfig, collect
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.evaluation.drivers import make_driver
    from raw2drive_ros.evaluation.expert import ExpertDriver
    from raw2drive_ros.evaluation.routes import weighted_types
    from raw2drive_ros.evaluation.table_actions import AdvisedDriver, through_table
    from raw2drive_ros.progress import bar
    from raw2drive_ros.simulation.camera_rig import SIZES

    _check(options)
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    scenarios = weighted_types(options.routes)
    noise = 0.0 if options.table else options.noise
    driver = make_driver(options.driver, options.bundle, options.training_run, noise)
    if options.table:
        driver = through_table(options.driver, driver, options.noise)
    if options.advice and not (options.table and options.driver == 'expert'):
        driver = AdvisedDriver(driver, ExpertDriver(), options.advice_every)
    config = CollectConfig(
        scenarios,
        options.ticks,
        options.seed,
        not options.no_cameras,
        options.episode_ticks,
        options.stand_ticks,
        image_size=SIZES[options.size],
        weathers=WEATHER_NAMES if options.weather == 'cycle' else (get_weather(options.weather).name,),
        vary=options.vary,
        twins=options.twins,
    )
    metadata = {
        'driver': options.driver,
        'noise': str(options.noise),
        'weather': options.weather,
        'table': str(options.table),
        'advice': str(options.advice or (options.table and options.driver == 'expert')),
    }
    identity = DriverSpec(options.driver, options.bundle, options.training_run).identity()
    bags, done = set(), 0
    try:
        with bar('collecting', options.ticks, 'ticks') as advance:
            for done, bag in collect(options.out, config, driver, metadata, identity):
                bags.add(bag)
                advance(done)
    except KeyboardInterrupt:
        note(f'{done} of {options.ticks} ticks are driven; the same command goes on, and ends with the same bags')
        raise
    print(f'{len(bags)} bags in {options.out}; next: raw2drive train privileged --bags {options.out} --run runs/stage1')
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raises UsageError for values out of range, and for options that would be without effect."""
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.table_actions import ASKED_TICKS
    from raw2drive_ros.simulation.camera_rig import SIZES

    at_least(options, 0, 'seed', 'stand_ticks')
    at_least(options, 1, 'ticks', 'episode_ticks')
    at_least(options, ASKED_TICKS, 'advice_every')
    if not 0.0 <= options.noise <= 1.0:
        raise UsageError(f'--noise {options.noise:g}: a chance per tick, from 0 to 1')
    if not 0.0 <= options.twins <= 1.0:
        raise UsageError(f'--twins {options.twins:g}: a share, from 0 to 1')
    if options.size not in SIZES:
        raise UsageError(f'--size {options.size}: use one of {", ".join(SIZES)}')
    refuse_for_drivers(options, options.driver)
    if options.table and driver_entry(options.driver).table:
        raise UsageError(f'--table: driver {options.driver} drives with actions of the table anyway')
    if options.noise and not options.table and 'noise' not in driver_entry(options.driver).reads:
        known = ', '.join(name for name, entry in DRIVERS.items() if 'noise' in entry.reads)
        raise UsageError(f'--noise: driver {options.driver} takes none; these do: {known}, and others with --table')
    if not options.advice:
        refuse(options, ['advice_every'], 'goes with --advice')
    if options.no_cameras:
        if driver_entry(options.driver).cameras:
            raise UsageError(f'--no-cameras: driver {options.driver} drives by the cameras')
        refuse(options, ['size', 'vary'], 'is of the camera images, which --no-cameras leaves out')
