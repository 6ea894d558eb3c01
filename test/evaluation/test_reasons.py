"""Why a driver decides so: from its decision into the advice of a bag and onto the pictures of a drive."""

import dataclasses

import numpy as np
import pytest

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts.privileged import MAX_REASON_CHARACTERS
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.table_actions import AdvisedDriver, TableActionDriver, reason_of
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.ticks import read_advice
from raw2drive_ros.report import scene
from raw2drive_ros.simulation.route_id import RouteId

WHY = 'give way: oncoming vehicle 12'


class Explains:
    """Gentle throttle, and a reason every second tick."""

    needs_cameras = needs_bev = False

    def reset(self, seed: int) -> None:
        self.ticks = 0

    def control(self, env, frame, tick) -> Decision:
        self.ticks += 1
        return Decision(frame.stamp_ns, Control(0.3), info={'reason': WHY} if self.ticks % 2 else {})


def reasons_in_bag(folder, driver) -> list[str]:
    config = CollectConfig(('LaneFollowing',), ticks=12, cameras=False, episode_ticks=12)
    (bag,) = {path for _, path in collect(folder, config, driver, {'driver': 'test'})}
    with open_bag(bag) as reader:
        return [advice.reason for advice in read_advice(reader, RosbagsFactory()).values()]


@pytest.mark.parametrize(
    'make',
    [lambda: TableActionDriver(Explains(), advises=True), lambda: AdvisedDriver(make_driver('constant'), Explains())],
)
def test_advice_in_a_bag_says_why(tmp_path, make) -> None:
    found = reasons_in_bag(tmp_path, make())
    # The last tick of an episode is not decided upon.
    assert found == [WHY, ''] * 5 + [WHY]


def test_the_driver_s_own_reason_is_not_taken_for_the_adviser_s(tmp_path) -> None:
    assert set(reasons_in_bag(tmp_path, AdvisedDriver(Explains(), make_driver('constant')))) == {''}


def test_a_reason_is_one_line_of_bounded_length() -> None:
    decision = Decision(0, Control(), info={'reason': 'two\nlines ' + 'x' * 1000})
    assert len(reason_of(decision)) == MAX_REASON_CHARACTERS and reason_of(decision).isprintable()
    assert reason_of(dataclasses.replace(decision, info={})) == ''


def test_pictures_of_a_drive_show_the_reason(tmp_path, monkeypatch) -> None:
    words: list[str] = []
    monkeypatch.setattr(scene, 'text', lambda canvas, said, *more, **how: words.append(said))
    scene.save_picture(tmp_path / 'a.png', RouteId('LaneFollowing', 1), (64, 96), Explains(), seconds=0.2)
    assert any(said.endswith(f'km/h: {WHY}') for said in words)
    words.clear()
    scene.save_film(tmp_path / 'a.mp4', RouteId('LaneFollowing', 1), (64, 96), Explains(), seconds=0.4)
    assert words.count(WHY) == 2 and np.array(words).size > 4
