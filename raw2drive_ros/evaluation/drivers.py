"""The registry of drivers: builds them by name, lists their names, describes each in one line.

Nothing heavy is imported before a driver is built, so that the command line and the bridge can list names quickly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from raw2drive_ros.contracts.errors import UnknownDriverError
from raw2drive_ros.contracts.near_names import unknown_name

if TYPE_CHECKING:
    from raw2drive_ros.evaluation.episode_driver import EpisodeDriver


@dataclass(frozen=True, slots=True)
class DriverOptions:
    """bundle: of driver raw. run: of driver privileged, whatever `load_teacher` takes; None: the shipped teacher.
    noise: chance per tick of a burst of random actions, see each driver. threads: of torch.
    arguments: key=value, of a driver that is a class."""

    bundle: Path | None = None
    run: Path | None = None
    noise: float = 0.0
    threads: int = 1
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class DriverEntry:
    """about: one line for people. table: its commands are actions of the policy's table. reads: names of the
    `DriverOptions` that it reads. cameras: it sees the camera images."""

    make: Callable[[DriverOptions], EpisodeDriver]
    about: str
    table: bool = False
    reads: tuple[str, ...] = ()
    cameras: bool = False


def _raw(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.raw_driver import RawDriver
    from raw2drive_ros.evaluation.episode_driver import SensorDriver

    if options.bundle is None:
        raise UnknownDriverError('driver raw needs a policy bundle (--bundle)')
    return SensorDriver(RawDriver(load_bundle(options.bundle), options.threads), cameras=True)


def _privileged(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.privileged_driver import PrivilegedDriver
    from raw2drive_ros.settings import default_teacher

    if options.run is None and not default_teacher().is_dir():
        raise UnknownDriverError(f'driver privileged needs --run: the shipped teacher is not at {default_teacher()}')
    return PrivilegedDriver(options.run or default_teacher(), options.noise)


def _expert(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.expert import ExpertDriver

    return ExpertDriver()


def _oracle(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.world_drivers import oracle_driver

    return oracle_driver()


def _rule(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.world_drivers import rule_driver

    return rule_driver(options.noise)


def _idm(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.world_drivers import idm_driver

    return idm_driver()


def _constant(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.evaluation.world_drivers import constant_driver

    return constant_driver()


def _straight(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.driving.baselines import StraightDriver
    from raw2drive_ros.evaluation.episode_driver import SensorDriver

    return SensorDriver(StraightDriver(), cameras=False)


def _random(options: DriverOptions) -> EpisodeDriver:
    from raw2drive_ros.driving.baselines import RandomDriver
    from raw2drive_ros.evaluation.episode_driver import SensorDriver

    return SensorDriver(RandomDriver(), cameras=False)


def _sightless(name: str) -> Callable[[DriverOptions], EpisodeDriver]:
    def make(options: DriverOptions) -> EpisodeDriver:
        from raw2drive_ros.evaluation.cheats import sightless_driver

        return sightless_driver(name)

    return make


# What must not win, see `cheats`: name -> line for people.
SIGHTLESS = {
    'creep': 'cheat: slow, feels 7 m ahead, obeys lights and stop signs',
    'wait': 'cheat: waits at the start, then drives at the limit, blind',
    'crawl': 'cheat: one speed, blind',
    'straddle_left': 'cheat: 2.15 m left of the route, blind',
    'straddle_right': 'cheat: 2.15 m right of the route, blind',
    'blind': 'cheat: route and speed limit alone, stops at turns',
    'memoriser': "cheat: repeats the expert's drive through the nearest training scene, blind",
    'profile': 'cheat: the best speed profile laid down in advance, blind',
    'script': 'cheat: of all these the one that wins most training routes of the type',
}
DRIVERS = {
    'raw': DriverEntry(
        _raw,
        'the raw policy on cameras, IMU, odometry and route',
        table=True,
        reads=('bundle', 'threads'),
        cameras=True,
    ),
    'privileged': DriverEntry(
        _privileged, 'the stage-1 policy on BEV masks', table=True, reads=('run', 'noise', 'threads')
    ),
    'expert': DriverEntry(_expert, 'plans on what has been visible, without knowing the future'),
    'oracle': DriverEntry(_oracle, 'tries its plans out in forks of the simulation: it knows the future'),
    'rule': DriverEntry(_rule, 'rules on the simulation: leaders, conflicts, lights, signs', reads=('noise',)),
    'idm': DriverEntry(_idm, 'IDM and MOBIL on the simulation'),
    'constant': DriverEntry(_constant, 'a constant speed along the route, whatever is ahead'),
    'straight': DriverEntry(_straight, 'gentle throttle, wheel straight'),
    'random': DriverEntry(_random, 'uniform random actions'),
    **{name: DriverEntry(_sightless(name), about) for name, about in SIGHTLESS.items()},
}
DRIVER_NAMES = tuple(DRIVERS)
# In the name of a driver that is a class.
CLASS_MARK = ':'


def driver_help() -> str:
    """The names in a sentence, for `--driver`."""
    return f'{", ".join(DRIVER_NAMES)} or package.module:Class'


def driver_list() -> str:
    """Every driver with its line, for the end of a verb's `--help`."""
    return 'drivers:\n' + '\n'.join(f'  {name:14s} {entry.about}' for name, entry in DRIVERS.items())


def _of_class(name: str) -> DriverEntry:
    """A driver that is a class of the user's, see `custom_driver`."""

    def make(options: DriverOptions) -> EpisodeDriver:
        from raw2drive_ros.evaluation.custom_driver import custom_driver

        return custom_driver(name, options.arguments)

    return DriverEntry(make, 'a class', reads=('arguments',), cameras=True)


def driver_entry(name: str) -> DriverEntry:
    """The driver of that name, which may be `package.module:Class`. Raises UnknownDriverError."""
    if CLASS_MARK in name:
        return _of_class(name)
    if name not in DRIVERS:
        raise UnknownDriverError(unknown_name('driver', name, DRIVER_NAMES))
    return DRIVERS[name]


def make_driver(
    name: str,
    bundle: Path | None = None,
    run: Path | None = None,
    noise: float = 0.0,
    threads: int = 1,
    arguments: tuple[str, ...] = (),
) -> EpisodeDriver:
    """A driver by name; see `DriverOptions`. Raises UnknownDriverError, DriverClassError, BundleError or
    CheckpointError."""
    return driver_entry(name).make(DriverOptions(bundle, run, noise, threads, arguments))
