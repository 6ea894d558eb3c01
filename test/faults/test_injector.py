"""Faults on messages: what is lost, late, frozen or wrong, and when; the same seed gives the same faults."""

import numpy as np
import pytest
import yaml

from msg_adapters.commands import decision_from_message, decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import (
    fill_image,
    image_from_message,
    imu_from_message,
    imu_to_message,
    new_image,
    odometry_from_message,
    odometry_to_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ConfigError, ContractError
from raw2drive_ros.contracts.public import Control, Decision, ImuSample, OdometrySample
from raw2drive_ros.driving.single_writer import Sender, SingleWriter
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.faults.plan import Fault, load_plans

FACTORY = RosbagsFactory()
FRONT = topics.image_topic('front')
SECOND = 1_000_000_000


def image(stamp: int, grey: int = 100) -> bytes:
    message = new_image(FACTORY, 'front', 8, 10)
    fill_image(message, np.full((8, 10, 3), grey, np.uint8), stamp)
    return FACTORY.serialize(message, 'sensor_msgs/msg/Image')


def command(stamp: int) -> bytes:
    message = decision_to_message(FACTORY, Decision(stamp, Control(0.3, 0.0, 0.1)))
    return FACTORY.serialize(message, 'sensor_msgs/msg/JointState')


def injector(topic: str, kind: str, **more) -> Injector:
    fault = Fault(topic=topic, kind=kind, start_s=1.0, duration_s=1.0, **more)
    made = Injector([fault], seed=3)
    made.start(0)
    return made


def through(made: Injector, topic: str, data: bytes, second: float):
    msgtype = topics.BY_NAME[topic].msgtype
    out = made.take(topic, msgtype, data, round(second * SECOND))
    return [(due, FACTORY.deserialize(found, msgtype)) for due, found in out]


def one(made: Injector, topic: str, data: bytes, second: float = 1.5):
    ((_, message),) = through(made, topic, data, second)
    return message


@pytest.mark.parametrize('second', [0.0, 0.99, 2.0, 9.0])
def test_outside_its_time_a_fault_touches_nothing(second) -> None:
    made = injector(FRONT, 'black')
    data = image(5)
    assert made.take(FRONT, 'sensor_msgs/msg/Image', data, round(second * SECOND)) == [(round(second * SECOND), data)]
    assert made.counts == {}


def test_other_topics_are_not_touched() -> None:
    assert image_from_message(one(injector(topics.image_topic('back'), 'black'), FRONT, image(5)))[0, 0, 0] == 100


def test_a_share_is_lost_reproducibly() -> None:
    def lost(seed: int) -> list[bool]:
        made = injector(FRONT, 'drop', amount=0.4)
        made.seed = seed
        return [not through(made, FRONT, image(5), 1.0 + i * 0.001) for i in range(300)]

    assert lost(3) == lost(3) != lost(4)
    assert 90 < sum(lost(3)) < 150
    made = injector(FRONT, 'drop')
    assert through(made, FRONT, image(5), 1.5) == []
    assert made.counts == {f'drop {FRONT}': 1}


def test_delay_and_duplicate() -> None:
    ((due, message),) = through(injector(FRONT, 'delay', amount=0.25), FRONT, image(5), 1.5)
    assert (due, stamp_ns(message.header.stamp)) == (1_750_000_000, 5)
    assert len(through(injector(FRONT, 'duplicate'), FRONT, image(5), 1.5)) == 2


def test_frozen_is_the_last_picture_before_under_new_stamps() -> None:
    made = injector(FRONT, 'freeze')
    for second, grey in ((0.8, 10), (0.9, 20), (1.0, 30), (1.1, 40)):
        message = one(made, FRONT, image(round(second * SECOND), grey), second)
    assert image_from_message(message)[0, 0, 0] == 20
    assert stamp_ns(message.header.stamp) == 1_100_000_000
    assert image_from_message(one(made, FRONT, image(5, 50), 2.0))[0, 0, 0] == 50


def test_stamps_are_moved_but_not_before_the_epoch() -> None:
    assert stamp_ns(one(injector(FRONT, 'stamp', amount=-1.0), FRONT, image(3 * SECOND)).header.stamp) == 2 * SECOND
    assert stamp_ns(one(injector(FRONT, 'stamp', amount=-1.0), FRONT, image(5)).header.stamp) == 0


@pytest.mark.parametrize(('kind', 'value'), [('black', 0), ('white', 255)])
def test_blind_pictures(kind, value) -> None:
    assert (image_from_message(one(injector(FRONT, kind), FRONT, image(5))) == value).all()


def test_noisy_and_contradictory_pictures() -> None:
    noisy = image_from_message(one(injector(FRONT, 'noise', amount=10.0), FRONT, image(5))).astype(float)
    assert 5 < noisy.std() < 15
    with pytest.raises(ContractError):
        image_from_message(one(injector(FRONT, 'shrink'), FRONT, image(5)))


def test_values_of_imu_and_odometry() -> None:
    imu = FACTORY.serialize(
        imu_to_message(FACTORY, ImuSample(5, (0.0, 0.0, 9.81), (0.0, 0.0, 0.1))), 'sensor_msgs/msg/Imu'
    )
    odometry = FACTORY.serialize(
        odometry_to_message(FACTORY, OdometrySample(5, 1.0, 2.0, 0.0, 4.0, 0.0)), 'nav_msgs/msg/Odometry'
    )
    assert imu_from_message(one(injector(topics.IMU, 'scale'), topics.IMU, imu)).specific_force_mps2[2] == 981.0
    noisy = odometry_from_message(one(injector(topics.ODOMETRY, 'noise', amount=0.1), topics.ODOMETRY, odometry))
    assert noisy.speed_mps != 4.0
    assert abs(noisy.speed_mps - 4.0) < 1.0
    for topic, data, convert in (
        (topics.IMU, imu, imu_from_message),
        (topics.ODOMETRY, odometry, odometry_from_message),
    ):
        with pytest.raises(ContractError, match='not finite'):
            convert(one(injector(topic, 'nan'), topic, data))


def test_commands_swing_lock_and_break() -> None:
    made = injector(topics.PROPOSED, 'swing')
    steers = [decision_from_message(one(made, topics.PROPOSED, command(5))).control.steer for _ in range(3)]
    assert steers == [1.0, -1.0, 1.0]
    locked = decision_from_message(one(injector(topics.PROPOSED, 'lock', amount=-0.7), topics.PROPOSED, command(5)))
    assert locked.control == Control(0.3, 0.0, -0.7)
    with pytest.raises(ContractError, match='not finite: throttle is nan, brake is nan'):
        decision_from_message(one(injector(topics.PROPOSED, 'nan'), topics.PROPOSED, command(5)))


@pytest.mark.parametrize('kind', ['swing', 'scale', 'stamp', 'freeze', 'duplicate'])
def test_a_fault_of_a_sender_is_numbered_and_signed_by_it(kind) -> None:
    sender, made = Sender(topics.PROPOSED, bytes(32)), Injector([Fault(topic=topics.PROPOSED, kind=kind, start_s=1.0)])
    made.key = bytes(32)
    writer, said = SingleWriter(topics.PROPOSED, bytes(32)), []
    for second in range(4):
        decision = Decision(second * 10**9, Control(0.3, 0.0, 0.1 * second), sequence=sender.next())
        data = FACTORY.serialize(sender.sign(decision_to_message(FACTORY, decision)), 'sensor_msgs/msg/JointState')
        for _, sent in made.take(topics.PROPOSED, 'sensor_msgs/msg/JointState', data, second * 10**9):
            said.append(writer.check(FACTORY.deserialize(sent, 'sensor_msgs/msg/JointState')))
    assert made.counts
    if kind == 'duplicate':
        assert [bool(why) for why in said] == [False, *[False, True] * 3]
        assert said[-1] == 'sequence number 4 after 4: repeated, or out of order'
    else:
        assert said == [''] * 4


@pytest.mark.parametrize(
    ('fault', 'message'),
    [
        ({'topic': '/nowhere', 'kind': 'drop'}, "no topic is called '/nowhere'"),
        ({'topic': '/privileged/*', 'kind': 'drop'}, 'privileged'),
        ({'topic': '*', 'kind': 'drop'}, 'privileged'),
        ({'topic': topics.IMU, 'kind': 'black'}, 'black does not go with /sensing/imu'),
        ({'topic': FRONT, 'kind': 'swing'}, 'swing does not go with'),
        ({'topic': FRONT, 'kind': 'nan'}, 'nan does not go with'),
        ({'topic': topics.ROUTE, 'kind': 'noise'}, 'noise does not go with'),
        ({'topic': FRONT, 'kind': 'black', 'amount': 1.0}, 'black takes no amount'),
        ({'topic': FRONT, 'kind': 'burn'}, 'kind'),
        ({'topic': FRONT, 'kind': 'drop', 'duration_s': 0.0}, 'duration_s'),
    ],
)
def test_a_wrong_plan_names_its_fault(tmp_path, fault, message) -> None:
    path = tmp_path / 'mine.yaml'
    path.write_text(yaml.safe_dump({'plans': {'one': [fault]}}))
    with pytest.raises(ConfigError, match=r'plans\.one\.0') as error:
        load_plans(str(path))
    assert message in str(error.value)


def test_unknown_plans_are_listed() -> None:
    with pytest.raises(ConfigError, match='known: matrix'):
        load_plans('nothing')
