import array
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters import commands, compressed, diagnostics, named_values, privileged, sensors
from msg_adapters.factory import RclpyFactory, RosbagsFactory
from msg_adapters.stamps import set_stamp, stamp_ns
from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import Advice, PrivilegedFrame, Transition
from raw2drive_ros.contracts.public import Control, Decision, ImuSample, OdometrySample, Route
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.tables.bev_channels import CHANNEL_COUNT

FACTORIES = {'rclpy': RclpyFactory(), 'rosbags': RosbagsFactory()}
factories = pytest.mark.parametrize('factory', FACTORIES.values(), ids=FACTORIES.keys())
stamps = st.integers(0, 2**31 * 10**9 - 1)
numbers = st.floats(-1e6, 1e6)
small = st.floats(-1e3, 1e3)
triples = st.tuples(numbers, numbers, numbers)


@factories
@given(stamp=stamps)
def test_stamps(factory, stamp) -> None:
    time = factory.new('builtin_interfaces/msg/Time')
    set_stamp(time, stamp)
    assert stamp_ns(time) == stamp


@factories
@given(stamp=stamps, force=triples, rate=triples)
def test_imu(factory, stamp, force, rate) -> None:
    sample = ImuSample(stamp, force, rate)
    message = sensors.imu_to_message(factory, sample)
    assert sensors.imu_from_message(message) == sample
    assert message.orientation_covariance[0] == -1.0


@factories
@given(stamp=stamps, x=numbers, y=numbers, yaw=st.floats(-math.pi + 1e-6, math.pi), v=small, w=small)
def test_odometry(factory, stamp, x, y, yaw, v, w) -> None:
    sample = OdometrySample(stamp, x, y, yaw, v, w)
    back = sensors.odometry_from_message(sensors.odometry_to_message(factory, sample))
    assert (back.stamp_ns, back.x_m, back.y_m, back.speed_mps, back.yaw_rate_radps) == (stamp, x, y, v, w)
    assert math.remainder(back.yaw_rad - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)


@factories
@given(stamp=stamps, points=st.lists(st.tuples(numbers, numbers), min_size=2, max_size=30))
def test_route(factory, stamp, points) -> None:
    route = Route(stamp, np.array(points))
    back = sensors.route_from_message(sensors.route_to_message(factory, route))
    assert back.stamp_ns == stamp
    assert np.array_equal(back.checkpoints_m, route.checkpoints_m)


@factories
@given(
    stamp=stamps,
    throttle=st.floats(0, 1),
    brake=st.floats(0, 1),
    steer=st.floats(-1, 1),
    reverse=st.booleans(),
    action=st.integers(-1, 38),
)
def test_command(factory, stamp, throttle, brake, steer, reverse, action) -> None:
    decision = Decision(stamp, Control(throttle, brake, steer, reverse), action, 1.5)
    assert commands.decision_from_message(commands.decision_to_message(factory, decision)) == decision


@factories
@given(seed=st.integers(0, 2**31), height=st.integers(1, 40), width=st.integers(1, 40))
@settings(max_examples=20)
def test_image(factory, seed, height, width) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    message = sensors.new_image(factory, 'front', height, width)
    sensors.fill_image(message, image, 5)
    assert np.array_equal(sensors.image_from_message(message), image)
    assert message.header.frame_id == 'camera_front_optical'


@factories
@given(seed=st.integers(0, 2**31), height=st.integers(1, 40), width=st.integers(1, 40))
@settings(max_examples=20)
def test_compressed_image(factory, seed, height, width) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    exact = compressed.compressed_image_to_message(factory, 'front', noise, 5, 'png')
    assert np.array_equal(compressed.image_from_compressed_message(exact), noise)
    assert stamp_ns(exact.header.stamp) == 5
    assert exact.format == 'rgb8; png compressed bgr8'
    flat = np.full((height, width, 3), noise[0, 0])
    lossy = compressed.image_from_compressed_message(compressed.compressed_image_to_message(factory, 'front', flat, 5))
    assert lossy.shape == flat.shape
    assert np.abs(lossy.astype(int) - flat).max() <= 4, 'red and blue must not change places'


@pytest.mark.parametrize('data', [b'', b'not an image'])
def test_bytes_that_are_no_image_are_refused(data) -> None:
    message = FACTORIES['rclpy'].new('sensor_msgs/msg/CompressedImage')
    message.data = data
    with pytest.raises(ContractError, match='cannot be decoded'):
        compressed.image_from_compressed_message(message)


def test_unknown_compression_is_refused() -> None:
    with pytest.raises(ContractError, match='jpeg, png'):
        compressed.compressed_image_to_message(FACTORIES['rosbags'], 'front', np.zeros((4, 4, 3), np.uint8), 0, 'webp')


def test_filling_an_image_keeps_the_one_fast_buffer() -> None:
    """rclpy copies a numpy array element by element; the buffer must stay the preallocated array.array."""
    message = sensors.new_image(FACTORIES['rclpy'], 'front', 96, 160)
    buffer = message.data
    sensors.fill_image(message, np.full((96, 160, 3), 7, np.uint8), 1)
    assert isinstance(message.data, array.array)
    assert message.data is buffer
    assert message.data[0] == 7


@factories
@pytest.mark.parametrize('encoding', ['bgr8', 'rgba8', 'bgra8', 'mono8'])
def test_other_encodings_become_rgb(factory, encoding) -> None:
    channels = sensors.CHANNELS_OF[encoding]
    pixels = np.arange(2 * 3 * channels, dtype=np.uint8).reshape(2, 3, channels)
    message = factory.new('sensor_msgs/msg/Image')
    message.height, message.width, message.step, message.encoding = 2, 3, 3 * channels, encoding
    message.data = factory.byte_buffer(pixels.size)
    np.frombuffer(message.data, np.uint8)[:] = pixels.ravel()
    image = sensors.image_from_message(message)
    order = {'bgr8': [2, 1, 0], 'rgba8': [0, 1, 2], 'bgra8': [2, 1, 0], 'mono8': [0, 0, 0]}[encoding]
    assert np.array_equal(image, pixels[..., order])


@pytest.mark.parametrize('change', [{'encoding': 'yuv422'}, {'step': 1}, {'height': 97}, {'width': 0}])
def test_a_broken_image_is_refused(change) -> None:
    message = sensors.new_image(FACTORIES['rclpy'], 'front', 96, 160)
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(ContractError):
        sensors.image_from_message(message)


@factories
def test_calibration(factory) -> None:
    for camera in camera_rig():
        info = sensors.camera_info_to_message(factory, camera, 3)
        pose = sensors.transform_to_message(factory, camera.base_from_camera, 'base_link', 'x', 3)
        back = sensors.calibration_from_messages(camera.name, info, pose)
        assert np.allclose(back.base_from_camera, camera.base_from_camera, atol=1e-12)
        assert np.array_equal(back.intrinsics, camera.intrinsics)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(v * v for v in q) > 0.1))
def test_quaternions_and_matrices_agree(values) -> None:
    q = np.array(values) / np.linalg.norm(values)
    matrix = sensors.matrix_from_quaternion(*q)
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-9)
    back = np.array(sensors.quaternion_from_matrix(matrix))
    assert np.allclose(back, q, atol=1e-6) or np.allclose(back, -q, atol=1e-6)


@factories
@given(seed=st.integers(0, 2**31))
@settings(max_examples=10)
def test_privileged(factory, seed) -> None:
    rng = np.random.default_rng(seed)
    bev = rng.random((CHANNEL_COUNT, 128, 128)) < 0.3
    frame = PrivilegedFrame(9, bev, rng.random(5).astype(np.float32))
    back = privileged.privileged_from_messages(
        privileged.bev_to_message(factory, bev, 9), privileged.ego_to_message(factory, frame)
    )
    assert np.array_equal(back.bev, bev)
    assert np.array_equal(back.ego, frame.ego)
    step = Transition(
        9,
        4,
        -0.5,
        {'speed': 0.25, 'steer': -0.75},
        is_first=False,
        is_terminal=True,
        is_last=True,
    )
    assert privileged.transition_from_message(privileged.transition_to_message(factory, step, 'A/3')) == (step, 'A/3')


@factories
def test_diagnostics(factory) -> None:
    message = diagnostics.diagnostics_to_message(factory, 'gate', diagnostics.WARN, 'late', {'age': 3}, 4)
    assert diagnostics.diagnostics_from_message(message) == [('raw2drive: gate', 1, 'late', {'age': '3'})]


@factories
def test_missing_actuators_are_named(factory) -> None:
    message = named_values.named_values_to_message(factory, {'throttle': 1.0}, 0)
    with pytest.raises(ContractError, match='brake, steer, reverse'):
        commands.decision_from_message(message)


@factories
def test_nan_in_motion_is_refused(factory) -> None:
    sample = OdometrySample(0, math.nan, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ContractError, match='not finite'):
        sensors.odometry_from_message(sensors.odometry_to_message(factory, sample))


def test_rclpy_and_rosbags_read_each_others_bytes() -> None:
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import JointState

    decision = Decision(123, Control(0.3, 0.0, -0.2), 16, 2.0)
    rclpy, rosbags = FACTORIES['rclpy'], FACTORIES['rosbags']
    ours = rosbags.serialize(commands.decision_to_message(rosbags, decision), 'sensor_msgs/msg/JointState')
    assert commands.decision_from_message(deserialize_message(ours, JointState)) == decision
    # rclpy's buffer has the size of its estimate: bytes beyond the message do not belong to it.
    theirs = bytes(serialize_message(commands.decision_to_message(rclpy, decision)))[: len(ours)]
    read = rosbags.deserialize(theirs, 'sensor_msgs/msg/JointState')
    assert commands.decision_from_message(read) == decision


@pytest.mark.parametrize('action', [-1, ACTION_COUNT, float('nan')])
def test_advice_outside_the_table_is_refused(action) -> None:
    factory = RosbagsFactory()
    assert privileged.advice_from_message(privileged.advice_to_message(factory, Advice(42, 5))) == Advice(42, 5)
    with pytest.raises(ContractError, match=r'not in the table|not finite'):
        privileged.advice_from_message(privileged.advice_to_message(factory, Advice(42, action)))


@factories
def test_an_orientation_too_large_to_square_is_refused(factory) -> None:
    message = sensors.odometry_to_message(factory, OdometrySample(1, 0.0, 0.0, 0.0, 0.0, 0.0))
    message.pose.pose.orientation.x = -1e200
    with pytest.raises(ContractError, match='not a unit quaternion'):
        sensors.odometry_from_message(message)


@factories
def test_a_message_does_not_share_memory_with_its_source(factory) -> None:
    camera = camera_rig()[0]
    message = sensors.camera_info_to_message(factory, camera, 1)
    before = camera.intrinsics.copy()
    message.k[0] = 5.0
    assert (camera.intrinsics == before).all()
