"""Drivers given as `package.module:Class`: what such a class declares, what it sees, and what it may return.

    class LaneKeeper:
        sensors = ('odometry', 'route')

        def drive(self, sensors):
            return Control(throttle=0.3)

`sensors` names what it wants of `SENSORS`. Its constructor takes the arguments of the command line by name. `reset`, if
there is one, is called with a seed before every drive. `drive` is called ten times a second with a `Sensors` and
returns a `Control`, an index into the table of 39 actions, or (throttle, brake, steer).
"""

from __future__ import annotations

import importlib
import inspect
import math
import numbers
import re
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from raw2drive_ros.artifact import hash_of_file
from raw2drive_ros.contracts.actions import ACTION_COUNT, ACTIONS, nearest_action
from raw2drive_ros.contracts.errors import ContractError, DriverClassError, DriverFailedError
from raw2drive_ros.contracts.near_names import did_you_mean
from raw2drive_ros.contracts.public import Control

PRIVILEGED = 'privileged'
# Sensor -> attributes of `Sensors` that it gives.
PROVIDES: dict[str, tuple[str, ...]] = {
    'cameras': ('images', 'calibration'),
    'imu': ('imu', 'imu_samples'),
    'odometry': ('odometry',),
    'route': ('route',),
    PRIVILEGED: ('world', 'privileged'),
}
SENSORS = tuple(PROVIDES)
GIVEN_BY = {attribute: sensor for sensor, attributes in PROVIDES.items() for attribute in attributes}
NAME = re.compile(r'[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*')


class Sensors:
    """What a driver sees of one tick. It has an attribute only if the driver declares the sensor that gives it.

    Always: stamp_ns; time_s, since the start of the drive. cameras: images, camera name -> (H, W, 3) uint8 RGB, and
    calibration, camera name -> CameraCalibration. imu: imu, the newest ImuSample, and imu_samples, all since the last
    tick. odometry: OdometrySample. route: Route. privileged: world, the simulator's World itself, and privileged, a
    PrivilegedFrame with the BEV masks.
    """

    stamp_ns: int
    time_s: float

    def __init__(self, stamp_ns: int, time_s: float, given: Mapping[str, Any]) -> None:
        self.__dict__.update(given, stamp_ns=stamp_ns, time_s=time_s)

    def __getattr__(self, name: str) -> Any:
        hint = f": declare '{GIVEN_BY[name]}' in `sensors`" if name in GIVEN_BY else did_you_mean(name, GIVEN_BY)
        raise AttributeError(f'sensors.{name} is not there{hint}')


def is_class_name(name: str) -> bool:
    """Whether a driver's name means a class: it has a colon."""
    return ':' in name


def find_class(name: str) -> type:
    """The class of that name, with `sensors` and `drive` as they should be. Looks in the working directory last.

    Raises DriverClassError.
    """
    if not NAME.fullmatch(name):
        raise DriverClassError(f'driver {name!r} is not of the form package.module:Class')
    module_name, _, class_name = name.partition(':')
    found = getattr(_module(name, module_name), class_name, None)
    if not isinstance(found, type):
        module = sys.modules[module_name]
        classes = [n for n, c in vars(module).items() if isinstance(c, type) and c.__module__ == module_name]
        near = did_you_mean(class_name, classes)
        known = f'; classes there: {", ".join(classes)}' if classes and not near else near
        raise DriverClassError(f'driver {name}: module {module_name} has no class {class_name}{known}')
    declared_sensors(found, name)
    if not callable(getattr(found, 'drive', None)):
        raise DriverClassError(f'driver {name}: has no method drive(self, sensors)')
    return found


def _module(name: str, module_name: str) -> Any:
    folder = str(Path.cwd())
    if folder not in sys.path:
        # Last, so that no file there stands in for a library.
        sys.path.append(folder)
    importlib.invalidate_caches()
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = str(error.name)
        if module_name == missing or module_name.startswith(f'{missing}.'):
            text = f'no module {missing} in the working directory or on PYTHONPATH'
            raise DriverClassError(f'driver {name}: {text}') from error
        raise DriverClassError(f'driver {name}: {described(error)}') from error
    except Exception as error:
        raise DriverClassError(f'driver {name}: {described(error)}') from error


def declared_sensors(found: type, name: str) -> tuple[str, ...]:
    """The sensors that a class declares. Raises DriverClassError."""
    wanted = getattr(found, 'sensors', None)
    example = f"sensors = ('cameras', 'imu'), of {', '.join(SENSORS)}"
    if not isinstance(wanted, tuple | list) or not all(isinstance(sensor, str) for sensor in wanted):
        raise DriverClassError(f'driver {name}: declares no sensors; write for instance {example}')
    for sensor in wanted:
        if sensor not in SENSORS:
            near = did_you_mean(sensor, SENSORS)
            raise DriverClassError(f'driver {name}: unknown sensor {sensor!r}{near or f"; write {example}"}')
    return tuple(sensor for sensor in SENSORS if sensor in wanted)


def make_instance(found: type, name: str, arguments: Mapping[str, Any]) -> Any:
    """An instance, whose methods take what they will be given. Raises DriverClassError."""
    parameters = [p for p in inspect.signature(found).parameters.values() if p.kind is not p.VAR_KEYWORD]
    try:
        inspect.signature(found).bind(**arguments)
    except TypeError as error:
        takes = ', '.join(map(str, parameters)) or 'nothing'
        raise DriverClassError(f'driver {name}: --driver-args: {error}; it takes {takes}') from error
    try:
        driver = found(**arguments)
    except Exception as error:
        raise DriverClassError(f'driver {name}: {described(error)}') from error
    for method, given, needed in (('drive', 'sensors', True), ('reset', 'seed', False)):
        function = getattr(driver, method, None)
        if function is None and not needed:
            continue
        try:
            inspect.signature(function).bind(0)  # type: ignore[arg-type]
        except TypeError as error:
            raise DriverClassError(f'driver {name}: {method}: {error}; write {method}(self, {given})') from error
    return driver


def described(error: BaseException) -> str:
    """An exception as one line, with the innermost place in a file that is not a library's."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if 'site-packages' not in f.filename and Path(f.filename).parent != Path(__file__).parent]
    place = f' ({Path(own[-1].filename).name}, line {own[-1].lineno})' if own and own[-1].filename[0] != '<' else ''
    return f'{type(error).__name__}: {" ".join(str(error).split())}{place}'


def argument(text: str) -> int | float | bool | str:
    """A value of the command line: a number, true or false, or else the text."""
    if text.lower() in ('true', 'false'):
        return text.lower() == 'true'
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def arguments_of(pairs: Sequence[str]) -> dict[str, int | float | bool | str]:
    """['gain=0.5', 'weights=net.npz'] as arguments of a constructor. Raises DriverClassError."""
    found: dict[str, int | float | bool | str] = {}
    for pair in pairs:
        key, equals, value = pair.partition('=')
        if not equals or not key.isidentifier():
            raise DriverClassError(f'--driver-args {pair}: write key=value')
        if key in found:
            raise DriverClassError(f'--driver-args: {key} is given twice')
        found[key] = argument(value)
    return found


def source_hash(found: type) -> str:
    """SHA-256 of the file that holds a class; '' where there is none."""
    try:
        return hash_of_file(Path(inspect.getfile(found)))
    except (OSError, TypeError):
        return ''


def command_of(answer: Any) -> tuple[Control, int]:
    """(control, index in the action table or the nearest one) that `drive` has returned. Raises DriverFailedError."""
    if isinstance(answer, Control):
        control = answer
    elif isinstance(answer, numbers.Integral) and not isinstance(answer, bool):
        action = int(answer)
        if not 0 <= action < ACTION_COUNT:
            raise DriverFailedError(f'drive returned action {action}, which is not in the table of {ACTION_COUNT}')
        return ACTIONS[action], action
    else:
        throttle, brake, steer = _three(answer)
        control = Control(throttle, brake, steer)
    try:
        control.validate()
        return control, nearest_action(control)
    except (ContractError, TypeError) as error:
        raise DriverFailedError(f'drive returned no command: {error}') from error


def _three(answer: Any) -> tuple[float, float, float]:
    try:
        values = [float(value) for value in answer]
    except (TypeError, ValueError) as error:
        text = 'a Control, an index of the action table, or (throttle, brake, steer)'
        raise DriverFailedError(f'drive returned {type(answer).__name__}, not {text}') from error
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise DriverFailedError(f'drive returned {values}, not three finite numbers: throttle, brake, steer')
    return values[0], values[1], values[2]
