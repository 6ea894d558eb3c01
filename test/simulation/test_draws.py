"""Parameters by name: the same for event and twin, and no two splits share a cell."""

import itertools

import pytest

from raw2drive_ros.simulation.draws import (
    BINS,
    EVALUATION,
    GAP,
    TRAIN_SEED_START,
    TRAINING,
    VALIDATION,
    VALIDATION_SEED_START,
    Draw,
    distance,
    split_of_seed,
)
from raw2drive_ros.simulation.route_id import RouteId

SEEDS = {EVALUATION: 3, VALIDATION: VALIDATION_SEED_START + 3, TRAINING: TRAIN_SEED_START + 3}


def scene(draw: Draw) -> Draw:
    """Draws three key parameters and one that is none, until the scene is of the seed's split."""
    while True:
        draw.choice('layout', ('straight', 'curve'), key=True)
        draw.uniform('event_s_m', 80.0, 240.0, key=True)
        draw.uniform('speed_mps', 4.0, 9.0, key=True)
        draw.uniform('colour', 0.0, 1.0)
        if draw.is_of_its_split():
            return draw
        draw = draw.again()


def test_a_value_depends_on_its_name_alone() -> None:
    one, other = Draw('Accident', 5), Draw('Accident', 5, event=False)
    other.uniform('something_else', 0.0, 1.0)
    assert other.uniform('place_m', 10.0, 20.0) == one.uniform('place_m', 10.0, 20.0)
    assert one.stream('arrivals').random() == other.stream('arrivals').random()
    assert Draw('Accident', 6).uniform('place_m', 10.0, 20.0) != one.uniform('place_m', 10.0, 20.0)
    assert one.again().uniform('place_m', 10.0, 20.0) != one.uniform('place_m', 10.0, 20.0)
    assert one.part('first').uniform('place_m', 10.0, 20.0) != one.part('second').uniform('place_m', 10.0, 20.0)


def test_one_name_has_one_meaning() -> None:
    draw = Draw('Accident', 5)
    draw.uniform('place_m', 10.0, 20.0)
    with pytest.raises(ValueError, match='place_m is drawn twice'):
        draw.uniform('place_m', 10.0, 30.0)


def test_values_fill_their_range_but_for_the_borders_of_its_bins() -> None:
    values = [Draw('Accident', seed).uniform('place_m', 0.0, BINS, key=True) for seed in range(2000)]
    parts = [value % 1.0 for value in values]
    assert min(parts) >= 0.1 - 1e-9 and max(parts) <= 0.9 + 1e-9
    counts = [sum(int(value) == number for value in values) for number in range(BINS)]
    assert min(counts) > 2000 / BINS * 0.8


@pytest.mark.parametrize(('one', 'other'), list(itertools.combinations(SEEDS, 2)))
def test_scenes_of_different_splits_are_never_near(one, other) -> None:
    first = [scene(Draw('Accident', SEEDS[one] + i)) for i in range(60)]
    second = [scene(Draw('Accident', SEEDS[other] + i)) for i in range(60)]
    assert {split_of_seed(draw.seed) for draw in first} == {one}
    assert not {draw.cell() for draw in first} & {draw.cell() for draw in second}
    nearest = min(distance(a.parameters, b.parameters) for a in first for b in second)
    assert nearest >= GAP - 1e-9
    assert distance(first[0].parameters, first[0].parameters) == 0.0


def test_a_twin_is_named_in_the_identifier() -> None:
    route = RouteId('T_Junction', 3, 'CloudyNight', 1, twin=True)
    assert str(route) == 'T_Junction-twin/3/CloudyNight/1'
    assert RouteId.parse(str(route)) == route
    assert RouteId.parse('T_Junction/3') == RouteId('T_Junction', 3)
