"""How the shipped suites are drawn. Data: to add a type or a suite, add it here."""

from __future__ import annotations

from dataclasses import dataclass

from raw2drive_ros.simulation.draws import TRAIN_SEED_START, VALIDATION_SEED_START
from raw2drive_ros.simulation.scenario import load_scenarios

EVENT, TWIN = 'event', 'twin'
PRACTICE = ('LaneFollowing', 'JunctionTurns', 'LongRoute')
# Bench2Drive's ten types for quick evaluations (spec 4.7).
DEV10 = (
    'ParkingExit',
    'ParkingCrossingPedestrian',
    'StaticCutIn',
    'HazardAtSideLane',
    'YieldToEmergencyVehicle',
    'ConstructionObstacleTwoWays',
    'NonSignalizedJunctionLeftTurn',
    'BlockedIntersection',
    'SequentialLaneChange',
    'SignalizedJunctionLeftTurnEnterFlow',
)
# Situation that no training type contains -> the type that is trained and comes nearest to it.
UNSEEN: dict[str, str] = {}
# Where evaluation suites that are not parts of each other begin to draw.
CATCH_SEED_START, UNSEEN_SEED_START = 10_000, 20_000


@dataclass(frozen=True, slots=True)
class SuitePlan:
    """`per_type` routes of each type, from `first_seed` on.

    drives: which drives of a pair belong to the suite. timed: each drive gets a time limit from that of the reference
    driver; otherwise those of the scenes hold. partners: unseen type -> seen type that it is compared with.
    """

    types: tuple[str, ...]
    per_type: int
    first_seed: int
    drives: tuple[str, ...] = (EVENT, TWIN)
    timed: bool = True
    partners: tuple[tuple[str, str], ...] = ()


def benchmark_types() -> tuple[str, ...]:
    """The 44 types of Bench2Drive."""
    return tuple(name for name in load_scenarios() if name not in PRACTICE and name not in UNSEEN)


def paired_types() -> tuple[str, ...]:
    """Those of them that have a twin."""
    known = load_scenarios()
    return tuple(name for name in benchmark_types() if known[name].paired)


def suite_plans() -> dict[str, SuitePlan]:
    """Name of each suite -> how it is drawn. A plan without types cannot be drawn yet."""
    types = benchmark_types()
    both = tuple(dict.fromkeys((*UNSEEN, *UNSEEN.values())))
    return {
        'b2d220': SuitePlan(types, 5, 0),
        'dev10': SuitePlan(DEV10, 1, 0),
        'long': SuitePlan(('LongRoute',), 12, 0),
        'catch': SuitePlan(paired_types(), 5, CATCH_SEED_START, drives=(TWIN,)),
        'unseen': SuitePlan(both, 5, UNSEEN_SEED_START, partners=tuple(UNSEEN.items())),
        'validation': SuitePlan(types, 2, VALIDATION_SEED_START),
        'train': SuitePlan(types, 36, TRAIN_SEED_START, timed=False),
    }
