"""raw2drive scenario: the list of scenario types, one drive as a picture or a video, or what it earns."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.driver_options import refuse_for_drivers
from raw2drive_ros.cli.parser import at_least, refuse_all_but
from raw2drive_ros.evaluation.drivers import driver_help

EXAMPLES = """examples:
  raw2drive scenario list
  raw2drive scenario show ParkingExit --seed 3 --picture scene.png
  raw2drive scenario show T_Junction --seed 7 --weather HardRainNight --driver raw --video drive.mp4
  raw2drive scenario show Accident --driver expert --seconds 12 --picture scene.png --video drive.mp4
  raw2drive scenario reward Accident --driver expert --against idm --picture reward.png
  raw2drive scenario gallery --out docs                 a page with a picture of every benchmark type

Seed, weather and repetition name the same drive as in the results of raw2drive evaluate."""

# The options of each action, by dest.
DRIVE = ('action', 'name', 'seed', 'weather', 'repetition', 'driver', 'bundle', 'training_run')
READS = {
    'list': ('action',),
    'show': (*DRIVE, 'blind', 'seconds', 'size', 'picture', 'video'),
    'reward': (*DRIVE, 'against', 'picture'),
    'gallery': ('action', 'out'),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('list', 'show', 'reward', 'gallery'))
    parser.add_argument('name', nargs='?', metavar='TYPE', help='scenario type (show, reward)')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--weather', default='ClearNoon', help='weather preset of the camera images')
    parser.add_argument('--repetition', type=int, default=0, help='0 is the route as drawn')
    parser.add_argument('--driver', default='rule', help=f'who drives: {driver_help()} (default: rule)')
    parser.add_argument('--against', default='constant', help='reward: another driver (default: constant)')
    parser.add_argument('--bundle', type=Path, help='policy bundle of driver raw (default: the shipped one)')
    parser.add_argument(
        '--run', dest='training_run', type=Path, help='of driver privileged: run, checkpoint or teacher'
    )
    parser.add_argument('--blind', action='store_true', help='black out every camera')
    parser.add_argument('--seconds', type=float, help='show the picture after so long (6 s), cut the video (never)')
    parser.add_argument('--size', default='96x160', help='camera images: 96x160, 224x400 or 64x96')
    parser.add_argument('--picture', type=Path, help='PNG to write (default, without --video: TYPE_SEED.png)')
    parser.add_argument('--video', type=Path, help='MP4 to write')
    parser.add_argument('--out', type=Path, default=Path('docs'), help='gallery: folder of scenarios.md and pictures')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.simulation.scenario import get_scenario

    refuse_all_but(options, READS[options.action], f'scenario {options.action}')
    if options.action == 'list':
        return print_list()
    if options.action == 'gallery':
        from raw2drive_ros.progress import bar
        from raw2drive_ros.report.gallery import write_gallery

        with bar('drawing', 44, 'types') as advance:
            print(write_gallery(options.out, advance))
        return 0
    if options.name is None:
        raise UsageError(f'scenario {options.action} needs a TYPE; see raw2drive scenario list')
    get_scenario(options.name)
    at_least(options, 0, 'seed', 'repetition', 'seconds')
    refuse_for_drivers(options, options.driver, *([options.against] if options.action == 'reward' else []))
    return _reward(options) if options.action == 'reward' else _show(options)


def print_list() -> int:
    """Every scenario type, its abilities, one line about it."""
    from raw2drive_ros.simulation.scenario import load_scenarios

    for name, scenario in load_scenarios().items():
        print(f'{name:44s} {", ".join(scenario.abilities) or "-":30s} {scenario.description}')
    return 0


def _reward(options: argparse.Namespace) -> int:
    """Drive twice under the rules of training, and plot the terms of the reward."""
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.report.reward_plot import save_reward_plot, trace
    from raw2drive_ros.settings import default_bundle
    from raw2drive_ros.simulation.route_id import RouteId
    from raw2drive_ros.simulation.weather import get_weather

    route = RouteId(options.name, options.seed, get_weather(options.weather).name, options.repetition)
    bundle = options.bundle or default_bundle()
    traces = {
        name: trace(route, DriverSpec(name, bundle, options.training_run).build())
        for name in dict.fromkeys((options.driver, options.against))
    }
    target = options.picture or Path(f'{route.type}_{route.seed}_reward.png')
    print(save_reward_plot(target, route, traces))
    for name, drive in traces.items():
        terms = ', '.join(f'{term} {values.sum():.1f}' for term, values in drive.terms.items())
        print(f'{name}: return {drive.discounted_return:.1f} discounted, {drive.rewards.sum():.1f} not: {terms}')
    return 0


def _show(options: argparse.Namespace) -> int:
    import cv2

    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.report.scene import SECONDS, outcome_of, save_film, save_picture
    from raw2drive_ros.settings import default_bundle
    from raw2drive_ros.simulation.camera_rig import SIZES
    from raw2drive_ros.simulation.route_id import RouteId
    from raw2drive_ros.simulation.weather import get_weather

    if options.size not in SIZES:
        raise UsageError(f'--size {options.size}: use one of {", ".join(SIZES)}')
    for flag, path, suffix in (('--picture', options.picture, '.png'), ('--video', options.video, '.mp4')):
        if path is not None and path.suffix.lower() != suffix:
            raise UsageError(f'{flag} {path}: give a name that ends in {suffix}')
    cv2.setNumThreads(1)
    route = RouteId(options.name, options.seed, get_weather(options.weather).name, options.repetition)
    bundle = options.bundle or default_bundle()
    driver = DriverSpec(options.driver, bundle, options.training_run, blind=options.blind).build()
    picture = options.picture or (None if options.video else Path(f'{route.type}_{route.seed}.png'))
    if picture is not None:
        seconds = SECONDS if options.seconds is None else options.seconds
        print(save_picture(picture, route, SIZES[options.size], driver, seconds))
    if options.video is not None:
        result = save_film(options.video, route, SIZES[options.size], driver, options.seconds)
        print(f'{options.video}: {outcome_of(result)}')
    return 0
