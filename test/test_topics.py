"""The topic table: what each publisher has, and what bags and nodes offer."""

from collections import Counter
from pathlib import Path

import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import PrivilegedImportError
from raw2drive_ros.contracts.privileged import ACTOR_DTYPE
from raw2drive_ros.contracts.topics import Publisher, published_by
from raw2drive_ros.driving.isolation import refuse_privileged_topic
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES
from raw2drive_ros.tables.vector_layout import EGO_FIELDS, SIGNAL_FIELDS


def test_every_topic_is_once_in_the_table_and_has_one_publisher() -> None:
    assert max(Counter(spec.name for spec in topics.TOPICS).values()) == 1
    assert sorted(name for each in Publisher for name in published_by(each)) == sorted(topics.BY_NAME)


def test_who_publishes_what() -> None:
    assert published_by(Publisher.CLOCK_SOURCE) == (topics.CLOCK,)
    assert published_by(Publisher.PLANNER) == (topics.PROPOSED,)
    assert published_by(Publisher.GATE) == (topics.COMMAND,)
    assert published_by(Publisher.COMMAND_RECEIVER) == (topics.STATUS, topics.AUTONOMY)
    assert published_by(Publisher.COLLECTOR) == (topics.ADVICE,)
    assert published_by(Publisher.ANY_NODE) == (topics.DIAGNOSTICS,)
    assert published_by(Publisher.SIMULATION) == (
        topics.BEV,
        topics.BEV_VISIBLE,
        topics.EGO,
        topics.SIGNALS,
        topics.ACTORS,
        topics.TRANSITION,
    )
    motion = (topics.IMU, topics.IMU_EXTRINSICS, topics.ODOMETRY, topics.ROUTE)
    assert published_by(Publisher.VEHICLE)[-4:] == motion
    assert len(published_by(Publisher.VEHICLE)) == 4 * len(topics.CAMERAS) + len(motion)


def test_a_vehicle_publishes_nothing_privileged_and_what_is_privileged_has_no_other_publisher() -> None:
    privileged = {spec.name for spec in topics.TOPICS if spec.privileged}
    assert privileged == set(published_by(Publisher.SIMULATION, Publisher.COLLECTOR))
    assert not privileged & {*topics.SENSOR_TOPICS, *topics.CARLA_BRIDGE_TOPICS}


def test_the_offered_qos_is_what_bags_have_always_held() -> None:
    found = Counter((s.qos.reliable, s.qos.latched, s.qos.depth) for s in topics.TOPICS)
    assert found == {
        # 6 cameras with 3 topics, 7 privileged ones, status; mounting poses of cameras and IMU, route, autonomy;
        # commands; motion; clock and diagnostics.
        (True, False, 5): 18 + 7 + 1,
        (True, True, 1): 6 + 1 + 1 + 1,
        (True, False, 1): 2,
        (True, False, 20): 2,
        (True, False, 10): 2,
    }


@pytest.mark.parametrize('name', [spec.name for spec in topics.TOPICS if spec.privileged])
def test_the_planner_refuses_every_privileged_topic_whatever_its_namespace(name) -> None:
    for written in (name, name.removeprefix('/'), f'/car1{name}', f'{name}/anything'):
        with pytest.raises(PrivilegedImportError, match='is privileged'):
            refuse_privileged_topic(written)


def test_no_public_topic_is_refused() -> None:
    for spec in topics.TOPICS:
        if not spec.privileged:
            refuse_privileged_topic(spec.name)


@pytest.mark.parametrize('name', [*ACTOR_DTYPE.names, *ACTOR_CLASSES, *EGO_FIELDS, *SIGNAL_FIELDS])
def test_the_document_explains_every_field_and_class_of_the_privileged_topics(name) -> None:
    documented = (Path(__file__).parents[1] / 'docs' / 'topics.md').read_text()
    shared = name.startswith('pixels_') and '`pixels_CAMERA`' in documented
    assert shared or f'`{name}`' in documented
