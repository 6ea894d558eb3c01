"""Actors, signals, the longer ego vector, advice with a reason: there and back, of old bags, with hostile values."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters import named_values, privileged
from msg_adapters.factory import RclpyFactory, RosbagsFactory
from msg_adapters.privileged_actors import DATATYPES, actor_fields, actors_from_message, actors_to_message
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import (
    ACTOR_DTYPE,
    ACTOR_RANGES,
    BEV_SHAPE,
    EGO_RANGES,
    MAX_ACTORS,
    MAX_REASON_CHARACTERS,
    SIGNAL_FLAGS,
    SIGNAL_RANGES,
    Advice,
    PrivilegedFrame,
)
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES
from raw2drive_ros.tables.vector_layout import (
    BASIC_EGO_FIELDS,
    EGO_FIELDS,
    EGO_SIZE,
    LIGHT_FIELDS,
    SIGNAL_FIELDS,
)

FACTORIES = {'rclpy': RclpyFactory(), 'rosbags': RosbagsFactory()}
factories = pytest.mark.parametrize('factory', FACTORIES.values(), ids=FACTORIES.keys())
CLOUD = 'sensor_msgs/msg/PointCloud2'


def some_rows(count: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, ACTOR_DTYPE)
    for name in ACTOR_DTYPE.names:
        low, high = ACTOR_RANGES.get(name, (0, 15_360))
        whole = ACTOR_DTYPE[name].kind in 'ui'
        high = min(high, 300.0)
        rows[name] = rng.integers(low, high + 1, count) if whole else rng.uniform(low, high, count)
    rows['number'] = rng.permutation(10 * count)[:count]
    if count:
        rows['since_seen_s'][0] = math.inf
    return rows


def some_signals(colour: str = 'light_red', **more: float):
    values = dict.fromkeys(SIGNAL_FIELDS, 0.0) | {colour: 1.0, 'light_distance_m': 31.5, 'speed_limit_mps': 13.9} | more
    return np.array(list(values.values()), np.float32)


@factories
@given(count=st.integers(0, 60), seed=st.integers(0, 2**31), stamp=st.integers(0, 2**31 * 10**9 - 1))
@settings(max_examples=20, deadline=None)
def test_actors_come_back_bit_for_bit(factory, count, seed, stamp) -> None:
    rows = some_rows(count, seed)
    message = actors_to_message(factory, rows, stamp)
    back = actors_from_message(message)
    assert back.dtype == ACTOR_DTYPE and back.tobytes() == rows.tobytes()
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (stamp, 'base_link')
    assert (message.height, message.width, message.point_step) == (1, count, 72)


@factories
def test_the_bytes_of_the_cloud_are_those_that_stock_tools_expect(factory) -> None:
    """Offsets, types and padding by hand, as `sensor_msgs_py` and RViz read them."""
    rows = some_rows(2)
    message = actors_to_message(factory, rows, 1)
    fields = {field.name: (field.offset, field.datatype, field.count) for field in message.fields}
    assert [fields[name] for name in 'xyz'] == [(0, 7, 1), (4, 7, 1), (8, 7, 1)]
    assert fields['number'] == (40, 6, 1) and fields['class'] == (68, 4, 1) and fields['indicator'] == (71, 1, 1)
    data = np.frombuffer(message.data, np.uint8)
    assert data[72:76].view('<f4')[0] == rows['x'][1]
    assert data[72 + 71 :].view('i1')[0] == rows['indicator'][1]


def test_rclpy_s_and_rosbags_bytes_of_actors_are_the_same() -> None:
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2

    rows, rosbags = some_rows(5), FACTORIES['rosbags']
    ours = rosbags.serialize(actors_to_message(rosbags, rows, 7), CLOUD)
    assert actors_from_message(deserialize_message(ours, PointCloud2)).tobytes() == rows.tobytes()
    theirs = bytes(serialize_message(actors_to_message(FACTORIES['rclpy'], rows, 7)))
    assert actors_from_message(rosbags.deserialize(theirs, CLOUD)).tobytes() == rows.tobytes()


def test_fields_are_found_by_name_and_unknown_ones_are_left_out() -> None:
    """A later version may add fields, and another writer may order them differently."""
    factory, rows = FACTORIES['rosbags'], some_rows(3)
    shuffled = np.dtype([('added_later', '<f8'), *((name, ACTOR_DTYPE[name]) for name in reversed(ACTOR_DTYPE.names))])
    points = np.zeros(3, shuffled)
    for name in ACTOR_DTYPE.names:
        points[name] = rows[name]
    message = actors_to_message(factory, rows, 1)
    message.fields = []
    for name in shuffled.names:
        field = factory.new('sensor_msgs/msg/PointField')
        field.name, field.offset = name, shuffled.fields[name][1]
        field.datatype, field.count = DATATYPES[shuffled[name].name], 1
        message.fields.append(field)
    message.point_step, message.row_step = shuffled.itemsize, 3 * shuffled.itemsize
    message.data = points.view(np.uint8)
    assert actors_from_message(message).tobytes() == rows.tobytes()


@factories
@pytest.mark.parametrize(
    ('change', 'why'),
    [
        ({'point_step': 0}, '216 bytes for 3 points of 0'),
        ({'point_step': 0, 'row_step': 0, 'width': 0, 'data': []}, 'points of 0 bytes'),
        ({'point_step': 2**31}, 'for 3 points'),
        ({'width': 2**32 - 1}, 'more than 1024'),
        ({'width': 4}, '216 bytes for 4 points'),
        ({'height': 0}, 'one row'),
        ({'height': 3, 'width': 1}, 'one row'),
        ({'row_step': 1}, '216 bytes'),
        ({'is_bigendian': True}, 'little-endian'),
        ({'data': [1, 2, 3]}, '3 bytes'),
        ({'fields': []}, 'missing x, y, z'),
    ],
)
def test_sizes_that_contradict_each_other_are_refused(factory, change, why) -> None:
    message = actors_to_message(factory, some_rows(3), 1)
    for name, value in change.items():
        setattr(message, name, np.array(value, np.uint8) if name == 'data' else value)
    with pytest.raises(ContractError, match=why):
        actors_from_message(message)


@factories
@pytest.mark.parametrize(
    ('field', 'change', 'why'),
    [
        ('yaw_rad', {'datatype': 8}, 'yaw_rad has type 8 x 1, not float32'),
        ('class', {'count': 2}, 'class has type 4 x 2'),
        ('number', {'offset': 70}, 'number lies beyond a point of 72 bytes'),
        ('number', {'offset': 2**32 - 4}, 'number lies beyond'),
        ('x', {'name': 'y'}, 'more than once'),
        ('pixels_back', {'name': 'pixels_rear'}, 'missing pixels_back'),
    ],
)
def test_a_field_that_is_not_as_declared_is_refused(factory, field, change, why) -> None:
    message = actors_to_message(factory, some_rows(2), 1, actor_fields(factory))
    (found,) = [each for each in message.fields if each.name == field]
    for name, value in change.items():
        setattr(found, name, value)
    with pytest.raises(ContractError, match=why):
        actors_from_message(message)


def test_too_many_fields_another_frame_and_too_many_actors_are_refused() -> None:
    factory = FACTORIES['rosbags']
    message = actors_to_message(factory, some_rows(2), 1)
    message.fields = message.fields * 4
    with pytest.raises(ContractError, match='80 fields'):
        actors_from_message(message)
    message = actors_to_message(factory, some_rows(2), 1)
    message.header.frame_id = 'map'
    with pytest.raises(ContractError, match="frame 'map', not base_link"):
        actors_from_message(message)
    with pytest.raises(ContractError, match=f'more than {MAX_ACTORS}'):
        actors_from_message(actors_to_message(factory, some_rows(MAX_ACTORS + 1), 1))


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('x', math.nan),
        ('y', -math.inf),
        ('z', 1e6),
        ('yaw_rad', 3.2),
        ('length_m', -1.0),
        ('height_m', math.nan),
        ('vx_mps', 151.0),
        ('since_seen_s', -0.1),
        ('since_seen_s', math.nan),
        ('class', len(ACTOR_CLASSES)),
        ('braking', 2),
        ('indicator', -2),
    ],
)
def test_an_actor_that_cannot_be_is_refused(field, value) -> None:
    rows = some_rows(4)
    rows[field][2] = value
    with pytest.raises(ContractError, match=f'actors: {field} of row 2 is'):
        actors_from_message(actors_to_message(FACTORIES['rosbags'], rows, 1))


def test_a_number_is_there_once_among_actors_among_lights_and_among_signs() -> None:
    rows = some_rows(4)
    rows['number'] = 5
    rows['class'] = [ACTOR_CLASSES.index(name) for name in ('walker', 'light_red', 'stop_sign', 'cyclist')]
    with pytest.raises(ContractError, match='two rows have one number'):
        actors_from_message(actors_to_message(FACTORIES['rosbags'], rows, 1))
    rows['number'][3] = 6
    assert len(actors_from_message(actors_to_message(FACTORIES['rosbags'], rows, 1))) == 4


@factories
def test_the_long_ego_vector_comes_back_and_the_short_one_stays_short(factory) -> None:
    ego = np.array([8.3, -0.25, 0.5, 0.0, 0.1, -1.75, 0.375], np.float32)
    for size in (EGO_SIZE, len(BASIC_EGO_FIELDS)):
        frame = PrivilegedFrame(9, np.zeros(BEV_SHAPE, bool), ego[:size])
        message = privileged.ego_to_message(factory, frame.validate())
        assert list(message.name) == list(EGO_FIELDS[:size])
        assert np.array_equal(privileged.ego_from_message(message), ego[:size])


@factories
@pytest.mark.parametrize('lost', ['lateral_offset_m', 'heading_error_rad', 'speed_mps'])
def test_half_an_ego_vector_is_refused(factory, lost) -> None:
    values = {name: 0.0 for name in EGO_FIELDS if name != lost}
    with pytest.raises(ContractError, match=f'missing {lost}'):
        privileged.ego_from_message(named_values.named_values_to_message(factory, values, 1))


@pytest.mark.parametrize('field', EGO_FIELDS[5:])
@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 1e4])
def test_an_impossible_place_on_the_route_is_refused(field, value) -> None:
    values = dict.fromkeys(EGO_FIELDS, 0.0) | {field: value}
    with pytest.raises(ContractError, match=field):
        privileged.ego_from_message(named_values.named_values_to_message(FACTORIES['rosbags'], values, 1))
    assert set(EGO_RANGES) == set(EGO_FIELDS)


@factories
@pytest.mark.parametrize('colour', LIGHT_FIELDS)
def test_signals_come_back(factory, colour) -> None:
    signals = some_signals(colour, stop_sign=1.0, stop_sign_distance_m=-0.5, stop_sign_obeyed=1.0)
    message = privileged.signals_to_message(factory, signals, 11)
    assert np.array_equal(privileged.signals_from_message(message), signals)
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (11, 'base_link')


@pytest.mark.parametrize('field', SIGNAL_FIELDS)
@pytest.mark.parametrize('value', [math.nan, math.inf, -2.0, 0.5, 1e6])
def test_impossible_signals_are_refused(field, value) -> None:
    good = dict(zip(SIGNAL_FIELDS, some_signals().tolist(), strict=True))
    message = named_values.named_values_to_message(FACTORIES['rosbags'], good | {field: value}, 1)
    if value == 0.5 and field not in SIGNAL_FLAGS:
        assert privileged.signals_from_message(message)[SIGNAL_FIELDS.index(field)] == 0.5
        return
    with pytest.raises(ContractError, match=field):
        privileged.signals_from_message(message)
    assert set(SIGNAL_RANGES) == set(SIGNAL_FIELDS)


def test_a_light_has_one_colour_and_no_signal_may_be_missing() -> None:
    factory = FACTORIES['rosbags']
    for lit in ({'light_green': 1.0}, {'light_red': 0.0}):
        with pytest.raises(ContractError, match='not one'):
            privileged.signals_from_message(privileged.signals_to_message(factory, some_signals(**lit), 1))
    values = {name: 0.0 for name in SIGNAL_FIELDS if name != 'speed_limit_mps'}
    with pytest.raises(ContractError, match='missing speed_limit_mps'):
        privileged.signals_from_message(named_values.named_values_to_message(factory, values, 1))


@factories
def test_advice_with_and_without_a_reason(factory) -> None:
    for reason in ('', 'give way: oncoming vehicle 12', 'hält für Fußgänger 3'):
        advice = Advice(42, 5, reason)
        message = privileged.advice_to_message(factory, advice)
        assert privileged.advice_from_message(message) == advice
    old = named_values.named_values_to_message(factory, {'action': 5.0}, 42, 'base_link')
    assert privileged.advice_from_message(old) == Advice(42, 5, '')


@pytest.mark.parametrize('reason', ['x' * (MAX_REASON_CHARACTERS + 1), 'two\nlines', 'clear \x1b[2J', 'turned \u202e'])
def test_a_reason_that_could_harm_a_terminal_is_refused(reason) -> None:
    message = privileged.advice_to_message(FACTORIES['rosbags'], Advice(42, 5, reason))
    with pytest.raises(ContractError, match='control characters'):
        privileged.advice_from_message(message)
    with pytest.raises(ContractError, match='control characters'):
        Advice(42, 5, reason).validate()
