from collections import Counter

import pytest

from raw2drive_ros.contracts.actions import ACTIONS, BRAKE_ACTION, PAPER_TABLE, nearest_action
from raw2drive_ros.contracts.public import Control


def test_counts_of_the_papers_table() -> None:
    assert len(ACTIONS) == 39
    assert sum(a.brake > 0 for a in ACTIONS) == 1
    assert sum(a.reverse for a in ACTIONS) == 9
    throttles = Counter(a.throttle for a in ACTIONS)
    assert throttles == {0.7: 9, 0.3: 11, 0.5: 9, 1.0: 1, 0.0: 9}


def test_action_zero_brakes() -> None:
    assert ACTIONS[BRAKE_ACTION] == Control(0.0, 1.0, 0.0, reverse=False)


def test_the_papers_positive_steer_is_negative_here() -> None:
    for row, action in zip(PAPER_TABLE, ACTIONS, strict=True):
        assert action.steer == -row[2]
    assert ACTIONS[20] == Control(0.3, 0.0, -0.7, reverse=False)


def test_every_action_is_valid_and_its_own_nearest() -> None:
    for index, action in enumerate(ACTIONS):
        assert nearest_action(action.validate()) == index


@pytest.mark.parametrize(
    ('control', 'index'),
    [(Control(0.0, 0.8), 0), (Control(0.32, 0.0, 0.02), 15), (Control(0.3, 0.0, 0.28), 12), (Control(0.9), 25)],
)
def test_nearest_action(control, index) -> None:
    assert nearest_action(control) == index
