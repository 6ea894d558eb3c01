"""`raw2drive attack` on a real graph: attacks end with a standing car, and without an attack nobody claims that."""

import time

import pytest

from raw2drive_ros.graph.attack import REACTION_S, Outcome, run_attacks
from raw2drive_ros.graph.attacks import Attack, attacks
from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.settings import default_bundle

QUICK = (
    'commands: full throttle at 300 Hz',
    'odometry: standing, and activate',
    'gate: killed and started again under a stop',
)


def carried_out(folder, chosen) -> list[Outcome]:
    with reserve_domain(None) as domain:
        return run_attacks(folder, domain, default_bundle().resolve(), chosen, 0, lambda outcome: None)


def test_attacks_end_with_a_standing_car_and_a_line_in_a_log_and_nothing_is_no_attack(tmp_path) -> None:
    # On a machine that is busy for a moment the gate stops the car for a late proposal, so there are three of these.
    nothing = [Attack(f'nothing {i}', lambda scene: time.sleep(0.5)) for i in range(3)]
    outcomes = carried_out(tmp_path, [*(a for a in attacks() if a.name in QUICK), *nothing])
    found, controls = outcomes[: len(QUICK)], outcomes[len(QUICK) :]
    for outcome in found:
        assert outcome.passed, outcome
    # The check can fail: a car that nobody attacks drives on, and nobody logs a stop.
    assert len(controls) == 3
    assert any(c.stand_s is None and not c.passed and c.largest_mps > 4.0 for c in controls), controls


@pytest.mark.long
def test_all_attacks(tmp_path) -> None:
    found = carried_out(tmp_path, list(attacks()))
    assert len(found) >= 30
    assert [outcome for outcome in found if not outcome.passed] == []


@pytest.mark.parametrize(
    ('changes', 'passed'),
    [
        ({}, True),
        ({'stand_s': None}, False),
        ({'stand_s': 3.01}, False),
        ({'moved_again': True}, False),
        ({'logged': ''}, False),
    ],
)
def test_what_counts_as_survived(changes, passed) -> None:
    good = {'stand_s': 3.0, 'allowed_s': REACTION_S + 4.5 / 3.0, 'moved_again': False, 'logged': 'safety_gate: x'}
    assert Outcome('x', 4.0, 4.5, **(good | changes)).passed is passed


def test_names_are_unique() -> None:
    names = [attack.name for attack in attacks()]
    assert len(set(names)) == len(names) >= 30
