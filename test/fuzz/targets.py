"""What users hand in, as bytes, and the errors that it may raise; any other exception is a find.

Each target takes the bytes of a fuzzer. `seeds` are valid inputs to start from.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from msg_adapters import sensors
from msg_adapters.commands import decision_from_message, decision_to_message
from msg_adapters.compressed import compressed_image_to_message, image_from_compressed_message
from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import (
    advice_from_message,
    ego_from_message,
    signals_from_message,
    transition_from_message,
)
from msg_adapters.privileged_actors import actors_from_message, actors_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import (
    BagError,
    BundleError,
    ConfigError,
    ContractError,
    ResultsError,
    RouteIdError,
    SoakError,
    UnknownScenarioError,
    UnknownSuiteError,
    UnknownWeatherError,
)
from raw2drive_ros.contracts.privileged import ACTOR_DTYPE
from raw2drive_ros.contracts.public import Control, Decision, ImuSample, OdometrySample, Route
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.evaluation.results import read_results
from raw2drive_ros.evaluation.soak import read_samples
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.faults.plan import load_plans
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag, read_calibrations
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.events import events_of
from raw2drive_ros.recording.recover import recover
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.settings import default_bundle, params_folder
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.timing import load_timing
from raw2drive_ros.training.recipe import load_recipe

FACTORY = RosbagsFactory()
READERS: dict[str, Callable[[Any], Any]] = {
    'sensor_msgs/msg/Image': sensors.image_from_message,
    'sensor_msgs/msg/CompressedImage': image_from_compressed_message,
    'sensor_msgs/msg/Imu': sensors.imu_from_message,
    'nav_msgs/msg/Odometry': sensors.odometry_from_message,
    'nav_msgs/msg/Path': sensors.route_from_message,
    'sensor_msgs/msg/JointState': lambda message: _named_values(message),
    'sensor_msgs/msg/PointCloud2': actors_from_message,
    'geometry_msgs/msg/TransformStamped': sensors.transform_from_message,
    'diagnostic_msgs/msg/DiagnosticArray': diagnostics_from_message,
    'sensor_msgs/msg/CameraInfo': lambda info: sensors.calibration_from_messages('front', info, _mounting()),
}


SMALL_BAG = (
    topics.ODOMETRY,
    topics.IMU,
    topics.ROUTE,
    topics.PROPOSED,
    topics.ACTORS,
    topics.compressed_topic('front'),
)


@dataclass(frozen=True, slots=True)
class Target:
    """run: raises nothing but `allowed` for any bytes."""

    run: Callable[[bytes], None]
    allowed: tuple[type[Exception], ...]
    seeds: Callable[[], list[bytes]]

    def __call__(self, data: bytes) -> None:
        try:
            self.run(data)
        except self.allowed as error:
            assert str(error), 'an error without a word'


@cache
def scratch() -> Path:
    """A folder for temporary files, in memory where possible; each part is cleared before its next use."""
    shared = Path('/dev/shm')
    folder = Path(tempfile.mkdtemp(prefix='raw2drive_fuzz_', dir=shared if shared.is_dir() else None))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _empty(name: str) -> Path:
    folder = scratch() / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


@cache
def _mounting() -> Any:
    return sensors.transform_to_message(FACTORY, np.eye(4), 'base_link', 'front', 1)


# -- messages -----------------------------------------------------------------------------------------


def _message(data: bytes) -> None:
    """First byte: which type. Then the message as CDR."""
    kinds = sorted(READERS)
    kind = kinds[data[0] % len(kinds)] if data else kinds[0]
    try:
        message = FACTORY.deserialize(data[1:], kind)
    except Exception:
        # The middleware, or the reader of the bag, rejects it before any adapter sees it.
        return
    READERS[kind](message)


def _named_values(message: Any) -> None:
    """Whatever topic it comes on; the last verdict is that on a command."""
    for read in (ego_from_message, signals_from_message, advice_from_message, transition_from_message):
        with suppress(ContractError):
            read(message)
    decision_from_message(message)


def _messages() -> list[bytes]:
    actors = np.zeros(3, ACTOR_DTYPE)
    actors['number'] = range(3)
    image = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    raw = sensors.new_image(FACTORY, 'front', 6, 8)
    sensors.fill_image(raw, image, 5)
    made = {
        'sensor_msgs/msg/Image': raw,
        'sensor_msgs/msg/CompressedImage': compressed_image_to_message(FACTORY, 'front', image, 5),
        'sensor_msgs/msg/Imu': sensors.imu_to_message(FACTORY, ImuSample(5, (0.0, 0.0, 9.8), (0.0, 0.0, 0.1))),
        'nav_msgs/msg/Odometry': sensors.odometry_to_message(FACTORY, OdometrySample(5, 1.0, 2.0, 0.5, 3.0, 0.1)),
        'nav_msgs/msg/Path': sensors.route_to_message(FACTORY, Route(5, np.array([[0.0, 0.0], [30.0, 1.0]]))),
        'sensor_msgs/msg/JointState': decision_to_message(FACTORY, Decision(5, Control(0.5), 3)),
        'geometry_msgs/msg/TransformStamped': _mounting(),
        'sensor_msgs/msg/PointCloud2': actors_to_message(FACTORY, actors, 5),
    }
    kinds = sorted(READERS)
    return [
        bytes([number]) + FACTORY.serialize(made.get(kind) or FACTORY.new(kind), kind)
        for number, kind in enumerate(kinds)
    ]


# -- bags ---------------------------------------------------------------------------------------------


@cache
def _small_bag() -> Path:
    """A bag of a second: odometry, IMU, route, a command, actors, a compressed picture."""
    folder = scratch() / 'small'
    by_type = {kind: data[1:] for kind, data in zip(sorted(READERS), _messages(), strict=True)}
    with BagWriter(folder, {'note': 'small'}) as bag:
        for tick in range(10):
            stamp = tick * 100_000_000
            for topic in SMALL_BAG:
                bag.write_raw(topic, stamp, by_type[topics.BY_NAME[topic].msgtype])
            if tick % 4 == 0:
                bag.flush()
    return folder


def _bag(data: bytes) -> None:
    """The MCAP file of a bag with valid metadata."""
    folder = _empty('bag')
    for file in _small_bag().iterdir():
        shutil.copy(file, folder)
    file = next(folder.glob('*.mcap'))
    file.write_bytes(data)
    examine(folder)
    for read in (bag_info, events_of, _read_all):
        try:
            read(folder)
        except BagError as error:
            assert str(folder) in str(error), 'an error that does not name the bag'
    saved = _empty('saved') / 'bag'
    recover(file, saved)
    bag_info(saved)


def _read_all(folder: Path) -> None:
    with open_bag(folder) as reader:
        read_calibrations(reader, FACTORY)
        for _ in read_ticks(reader, folder, cameras=True, privileged=False):
            pass


def _metadata(data: bytes) -> None:
    folder = _empty('bag')
    for file in _small_bag().iterdir():
        shutil.copy(file, folder)
    (folder / 'metadata.yaml').write_bytes(data)
    examine(folder)
    bag_info(folder)


# -- files --------------------------------------------------------------------------------------------


def _file(name: str, load: Callable[[Path], object]) -> Callable[[bytes], None]:
    def run(data: bytes) -> None:
        path = _empty('file') / name
        path.write_bytes(data)
        load(path)

    return run


def _parameters(data: bytes) -> None:
    """First byte: which kind of file. Then its text."""
    loads: list[Callable[[Path], object]] = [
        load_gate_config,
        load_monitor_config,
        load_timing,
        lambda path: load_plans(str(path)),
        lambda path: load_recipe(str(path)),
    ]
    _file('file.yaml', loads[data[0] % len(loads) if data else 0])(data[1:])


def _parameter_files() -> list[bytes]:
    names = ('gate.yaml', 'monitor.yaml', 'timing.yaml', 'faults/matrix.yaml', 'recipes/teacher.yaml')
    return [bytes([n]) + (params_folder() / name).read_bytes() for n, name in enumerate(names)]


def _bundle(data: bytes) -> None:
    """`bundle.json` of a bundle with valid weights."""
    folder = _empty('bundle')
    for file in default_bundle().iterdir():
        if file.is_file() and file.name != 'bundle.json':
            (folder / file.name).symlink_to(file.resolve())
    (folder / 'bundle.json').write_bytes(data)
    load_bundle(folder)


def _route(data: bytes) -> None:
    text = data.decode('utf-8', 'replace')
    route = RouteId.parse(text)
    assert RouteId.parse(str(route)) == route


HEADER = (
    b'{"status": "failed, no data", "started": 1.0, "driver": "x", "suite": "s", "version": "1", "routes": ["A/1"]}\n'
)
SAMPLE = b'{"part": 1, "simulated_s": 1.0, "wall_s": 1.0, "episodes": 0, "values": {"a/handles": 3.0}}\n'

TARGETS = {
    'message': Target(_message, (ContractError,), _messages),
    'bag': Target(_bag, (BagError,), lambda: [next(_small_bag().glob('*.mcap')).read_bytes()]),
    'metadata': Target(_metadata, (BagError,), lambda: [(_small_bag() / 'metadata.yaml').read_bytes()]),
    'parameters': Target(_parameters, (ConfigError,), _parameter_files),
    'bundle': Target(_bundle, (BundleError,), lambda: [(default_bundle() / 'bundle.json').read_bytes()]),
    'route': Target(
        _route,
        (RouteIdError, UnknownWeatherError, UnknownScenarioError),
        lambda: [b'Accident/1', b'T_Junction/2/FogNoon/3'],
    ),
    'results': Target(_file('r.jsonl', read_results), (ResultsError,), lambda: [HEADER]),
    'samples': Target(_file('s.jsonl', read_samples), (SoakError,), lambda: [SAMPLE]),
    'suite': Target(
        _file('s.json', lambda path: load_suite(str(path))),
        (UnknownSuiteError,),
        lambda: [(params_folder() / 'suites' / 'dev10.json').read_bytes()],
    ),
}
