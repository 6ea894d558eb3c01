"""Random damage to what users hand in: bags, messages, YAML, bundles, routes. Each gives one clear error at most."""

import json
import shutil

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msg_adapters.commands import decision_from_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import (
    image_from_message,
    imu_from_message,
    odometry_from_message,
    odometry_to_message,
    route_from_message,
    transform_from_message,
)
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import (
    BagError,
    BundleError,
    ConfigError,
    ContractError,
    RouteIdError,
    UnknownWeatherError,
)
from raw2drive_ros.contracts.public import OdometrySample
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.faults.plan import load_plans
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.recover import recover
from raw2drive_ros.settings import params_folder
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.timing import load_timing
from raw2drive_ros.training.recipe import load_recipe

FACTORY = RosbagsFactory()
SLOW = settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
# (position as a share of the size, bytes): a few bytes of a file are overwritten.
DAMAGE = st.lists(st.tuples(st.floats(0, 0.999), st.binary(min_size=1, max_size=40)), min_size=1, max_size=4)
CUT = st.none() | st.floats(0.0, 0.99)


def hurt(data: bytes, damage, cut) -> bytes:
    changed = bytearray(data)
    for where, what in damage:
        at = int(where * len(changed))
        changed[at : at + len(what)] = what[: len(changed) - at]
    return bytes(changed if cut is None else changed[: int(cut * len(changed))])


@pytest.fixture(scope='module')
def small_bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('small') / 'bag'
    with BagWriter(path, {'note': 'small'}) as bag:
        for tick in range(200):
            sample = OdometrySample(tick * 50_000_000, tick * 0.1, 0.0, 0.0, 2.0, 0.0)
            bag.write(topics.ODOMETRY, sample.stamp_ns, odometry_to_message(bag.factory, sample))
            if tick % 50 == 0:
                bag.flush()
    return path


@SLOW
@given(DAMAGE, CUT)
def test_a_damaged_bag_is_one_clear_error_or_is_read(small_bag, tmp_path_factory, damage, cut) -> None:
    folder = tmp_path_factory.mktemp('hurt')
    shutil.copytree(small_bag, folder / 'bag')
    file = next((folder / 'bag').glob('*.mcap'))
    file.write_bytes(hurt(file.read_bytes(), damage, cut))
    try:
        assert bag_info(folder / 'bag')['messages'] <= 400
    except BagError as error:
        assert 'bag' in str(error)
    assert isinstance(examine(folder / 'bag'), list)
    try:
        found = recover(file, folder / 'saved')
        assert sum(found.counts.values()) <= 400
        assert bag_info(folder / 'saved')['messages'] == sum(found.counts.values())
    except BagError:
        assert not (folder / 'saved').exists()
    assert not list(folder.glob('.*partial'))


READERS = {
    'sensor_msgs/msg/Image': image_from_message,
    'sensor_msgs/msg/Imu': imu_from_message,
    'nav_msgs/msg/Odometry': odometry_from_message,
    'nav_msgs/msg/Path': route_from_message,
    'sensor_msgs/msg/JointState': decision_from_message,
    'geometry_msgs/msg/TransformStamped': transform_from_message,
}


@settings(deadline=None, max_examples=400)
@given(st.sampled_from(sorted(READERS)), DAMAGE)
def test_a_message_with_random_values_is_read_or_refused(msgtype, damage) -> None:
    """Byte damage that still decodes: what a faulty publisher can send."""
    message = FACTORY.new(msgtype)
    if msgtype == 'sensor_msgs/msg/JointState':
        message.name, message.position = ['throttle', 'brake', 'steer', 'reverse'], FACTORY.new(msgtype).position
    data = hurt(FACTORY.serialize(message, msgtype), damage, None)
    try:
        changed = FACTORY.deserialize(data, msgtype)
    except Exception:
        # The middleware rejects it before our code sees it.
        return
    try:
        READERS[msgtype](changed)
    except ContractError:
        return


TEXT = st.text(max_size=60) | st.sampled_from(
    ['{', '- 1', '1: 2', 'a: &a [*a]', '!!python/object:os.system {}', 'x: [1']
)
SCALAR = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
NESTED = st.recursive(
    SCALAR, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
)


@settings(deadline=None, max_examples=150, suppress_health_check=list(HealthCheck))
@given(TEXT)
def test_any_text_in_place_of_a_yaml_file_is_a_clear_error(tmp_path_factory, text) -> None:
    path = tmp_path_factory.mktemp('yaml') / 'file.yaml'
    path.write_text(text)
    for load in (load_gate_config, load_monitor_config, load_timing, lambda p: load_plans(str(p)), load_recipe_file):
        with pytest.raises(ConfigError, match='file'):
            load(path)


def load_recipe_file(path):
    return load_recipe(str(path))


@SLOW
@given(st.sampled_from(['gate', 'monitor', 'timing']), st.data())
def test_a_random_value_in_a_parameter_file_is_taken_or_named(tmp_path_factory, name, data) -> None:
    loaded = yaml.safe_load((params_folder() / f'{name}.yaml').read_text())
    place = data.draw(st.sampled_from([loaded, *(v for v in loaded.values() if isinstance(v, dict))]))
    field = data.draw(st.sampled_from(sorted(place)))
    place[field] = data.draw(NESTED)
    path = tmp_path_factory.mktemp('yaml') / f'{name}.yaml'
    path.write_text(yaml.safe_dump(loaded))
    try:
        {'gate': load_gate_config, 'monitor': load_monitor_config, 'timing': load_timing}[name](path)
    except ConfigError as error:
        assert name in str(error)


@SLOW
@given(st.sampled_from(['bundle.json', 'weights.safetensors']), DAMAGE, CUT)
def test_a_damaged_bundle_is_refused(bundle, tmp_path_factory, name, damage, cut) -> None:
    folder = tmp_path_factory.mktemp('bundle') / 'bundle'
    shutil.copytree(bundle, folder)
    file = folder / name
    before = file.read_bytes()
    after = hurt(before, damage, cut)
    file.write_bytes(after)
    if after == before or (name == 'bundle.json' and decides_the_same(before, after)):
        load_bundle(folder)
        return
    with pytest.raises(BundleError):
        load_bundle(folder)


def decides_the_same(before: bytes, after: bytes) -> bool:
    """Other white space, or other metadata, which the identity leaves out: no damage to what drives."""
    try:
        old, new = (json.loads(text) for text in (before, after))
    except ValueError:
        return False
    return isinstance(new, dict) and old | {'facts': None} == new | {'facts': None} and 'facts' in new


@pytest.mark.parametrize('seed', ['²', '٣', '9' * 5000, ''])
def test_only_plain_numbers_are_seeds(seed) -> None:
    with pytest.raises(RouteIdError):
        RouteId.parse(f'Accident/{seed}')


@settings(max_examples=300)
@given(st.text(max_size=40) | st.from_regex(r'[A-Za-z]{1,12}(/[0-9A-Za-z-]{0,12}){0,4}', fullmatch=True))
def test_any_text_is_a_route_or_a_clear_error(text) -> None:
    try:
        route = RouteId.parse(text)
    except (RouteIdError, UnknownWeatherError):
        return
    assert RouteId.parse(str(route)) == route
