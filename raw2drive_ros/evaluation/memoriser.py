"""A driver that replays training drives of the reference driver and senses nothing.

It takes the recorded drive whose scene is nearest to its own (`draws.distance` of all key parameters, more than any
driver could know; then the shape of the route) and repeats its speeds, by the clock or by the place.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from raw2drive_ros.contracts.public import Control, Float64
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.draws import Parameter, distance
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

EVERY_TICKS = 5
STANDING_MPS = 0.2
SHAPE_STATIONS = 10
CATCH_UP_1PS, GAIN_1PS, HARDEST_MPS2 = 0.6, 3.0, 7.0
# The memory is read so far ahead (s, m), because the car takes a moment to get faster or slower.
AHEAD_S, AHEAD_M = 0.35, 1.0
# How the stands of a memory are approached when it is repeated by the place.
BRAKING_MPS2 = 3.0


@dataclass(frozen=True, slots=True)
class Recorded:
    """One drive of the reference driver.

    moments: (N, 4): time (s), way since the start (m), lateral offset (m), speed (m/s), every `EVERY_TICKS` decisions.
    shape: see `shape_of`. parameters: the key parameters of the scene.
    """

    type: str
    seed: int
    twin: bool
    parameters: dict[str, Parameter]
    shape: tuple[float, ...]
    moments: Float64

    def stored(self) -> dict[str, Any]:
        """Times need not be stored; the others are, in tenths."""
        return {
            'seed': self.seed,
            'twin': self.twin,
            'parameters': {n: [p.value, *(p.span or ())] for n, p in sorted(self.parameters.items())},
            'shape': [round(value, 2) for value in self.shape],
            'moments': np.rint(self.moments[:, 1:] * 10.0).astype(int).ravel().tolist(),
        }

    @staticmethod
    def from_stored(kind: str, body: Mapping[str, Any]) -> Recorded:
        """Raises ValueError, KeyError, TypeError."""
        values = np.array(body['moments'], float).reshape(-1, 3) / 10.0
        if not len(values) or not np.isfinite(values).all():
            raise ValueError('moments: empty, or not numbers')
        times = np.arange(len(values)) * EVERY_TICKS / DECISION_HZ
        parameters = {
            name: Parameter(value, (float(span[0]), float(span[1])) if span else None, key=True)
            for name, (value, *span) in body['parameters'].items()
        }
        shape = tuple(map(float, body['shape']))
        return Recorded(
            kind, int(body['seed']), bool(body['twin']), parameters, shape, np.column_stack([times, values])
        )


@dataclass(frozen=True, slots=True)
class Replay:
    """How memories are repeated. twin: those of twins, otherwise of events. clock: by the clock, otherwise by the
    place, with the recorded stands. lateral: the recorded offsets too."""

    twin: bool = False
    clock: bool = True
    lateral: bool = True

    def stored(self) -> dict[str, Any]:
        return {'twin': self.twin, 'clock': self.clock, 'lateral': self.lateral}

    @staticmethod
    def from_stored(values: Mapping[str, Any]) -> Replay:
        """Raises ValueError for what `stored` does not give."""
        if set(values) - {'twin', 'clock', 'lateral'} or not all(type(v) is bool for v in values.values()):
            raise ValueError(f'{dict(values)!r}: not twin, clock, lateral with true or false')
        return Replay(**values)


def shape_of(world: World) -> tuple[float, ...]:
    """Length of the route (in tens of metres) and its turn (rad) at equal steps from the start."""
    start = world.scene.route.start_s_m
    stations = np.linspace(start, world.goal_s_m, SHAPE_STATIONS)
    yaws = [world.route.pose(float(s))[2] for s in stations]
    return ((world.goal_s_m - start) / 10.0, *(float(yaw - yaws[0]) for yaw in yaws))


def key_parameters(world: World) -> dict[str, Parameter]:
    """The parameters of the scene that count for splits and distances."""
    return {name: parameter for name, parameter in world.draw.parameters.items() if parameter.key}


def nearest(world: World, memories: Iterable[Recorded], replay: Replay) -> Recorded | None:
    """The memory of this type, of another seed, that is nearest to the world's scene."""
    own, shape = key_parameters(world), shape_of(world)
    kind, seed = world.scenario.name, world.draw.seed
    wanted = [m for m in memories if m.type == kind and m.seed != seed]
    # A type without a twin has memories of events alone.
    wanted = [m for m in wanted if m.twin == replay.twin] or wanted

    def apart(memory: Recorded) -> tuple[float, float, int]:
        return distance(own, memory.parameters), math.dist(shape, memory.shape), memory.seed

    return min(wanted, key=apart, default=None)


class MemoryDriver:
    """`control(world)` returns a `Control`; it stands where it has no memory of the type. A new one for every drive."""

    def __init__(self, memories: Sequence[Recorded], replay: Replay) -> None:
        self.memories, self.replay = memories, replay
        self.chosen: Recorded | None = None
        self.stands: list[tuple[float, float]] = []

    def control(self, world: World) -> Control:
        speed = max(world.ego.speed, 0.0)
        if self.chosen is None:
            self.chosen = nearest(world, self.memories, self.replay)
            if self.chosen is None:
                return pedals(world, -3.0 if speed > 0.05 else 0.0, 0.0)
            self.stands = stands_of(self.chosen.moments)
        way_m = world.route_s_m - world.scene.route.start_s_m
        by_clock = self.replay.clock
        acceleration = self._by_clock(world.time_s, way_m, speed) if by_clock else self._by_place(way_m, speed)
        offset_m = 0.0
        if self.replay.lateral:
            moments = self.chosen.moments
            offset_m = float(np.interp(way_m + max(4.0, 0.8 * speed), moments[:, 1], moments[:, 2]))
        return pedals(world, acceleration, pursuit_steer(world, offset_m=offset_m))

    def _by_clock(self, time_s: float, way_m: float, speed: float) -> float:
        assert self.chosen is not None
        times, ways, _, speeds = self.chosen.moments.T
        time_s += AHEAD_S
        place = float(np.interp(time_s, times, ways)) - AHEAD_S * float(np.interp(time_s, times, speeds))
        # After the end of the memory it goes on at its last speed.
        place += max(0.0, time_s - times[-1]) * float(speeds[-1])
        wanted = max(0.0, float(np.interp(time_s, times, speeds)) + CATCH_UP_1PS * (place - way_m))
        return min(max(GAIN_1PS * (wanted - speed), -HARDEST_MPS2), 3.0)

    def _by_place(self, way_m: float, speed: float) -> float:
        assert self.chosen is not None
        _, ways, _, speeds = self.chosen.moments.T
        moving = speeds > STANDING_MPS
        ahead_m = way_m + AHEAD_M + AHEAD_S * speed
        wanted = max(1.0, float(np.interp(ahead_m, ways[moving], speeds[moving]))) if moving.any() else 0.0
        while self.stands and way_m > self.stands[0][0] + 2.5:
            del self.stands[0]
        if self.stands:
            place_m, left_s = self.stands[0]
            if speed < STANDING_MPS and place_m - way_m < 2.5:
                self.stands[0] = (place_m, left_s - 1.0 / DECISION_HZ)
                if left_s <= 0.0:
                    del self.stands[0]
            wanted = (
                min(wanted, math.sqrt(2.0 * BRAKING_MPS2 * max(0.0, place_m - way_m - 0.3))) if left_s > 0.0 else wanted
            )
        return min(max(GAIN_1PS * (wanted - speed), -HARDEST_MPS2), 3.0)


def stands_of(moments: Float64) -> list[tuple[float, float]]:
    """(way m, seconds) of every stand in a recorded drive, the one at the start included."""
    found: list[tuple[float, float]] = []
    for time_s, way_m, _, speed in moments.tolist():
        if speed >= STANDING_MPS or (time_s == 0.0 and len(moments) > 1 and moments[1, 3] >= STANDING_MPS):
            continue
        step_s = EVERY_TICKS / DECISION_HZ
        if found and way_m - found[-1][0] < 1.0:
            found[-1] = (found[-1][0], found[-1][1] + step_s)
        else:
            found.append((way_m, step_s))
    return found
