"""Attacks a real graph on this machine and measures what the car does: largest speed afterwards, time to stand, log."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import GraphError
from raw2drive_ros.graph.attack_scene import Scene, scene
from raw2drive_ros.graph.attacks import Attack, full_throttle

STANDS_MPS = 0.3
# From the first message or signal until the brakes are on; what the brakes then need is `Attack.brakes_mps2`.
REACTION_S = 1.5
STAND_WITHIN_S = 15.0
# How long a car that stands is watched: nothing may make it start again by itself.
WATCHED_S = 3.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """One row of the table; times in seconds from the first message or signal of the attack.

    before_mps: speed when the first message or signal was sent. largest_mps: the largest speed from then on. stand_s:
    when the car stood, None: never. allowed_s: when it has to. moved_again: whether it started again before anybody
    activated. logged: first line of gate, vehicle or planner that says so, '' if nobody did.
    """

    attack: str
    before_mps: float
    largest_mps: float
    stand_s: float | None
    allowed_s: float
    moved_again: bool
    logged: str

    @property
    def passed(self) -> bool:
        stood = self.stand_s is not None and self.stand_s <= self.allowed_s
        return stood and not self.moved_again and bool(self.logged)


def carry_out(at: Scene, attack: Attack) -> Outcome:
    """One attack on a car that drives. Raises GraphError when the car does not drive beforehand."""
    from raw2drive_ros.nodes.attacker import Stranger

    at.drive()
    time.sleep(at.rng.uniform(0.0, 0.5))
    at.new_lines()
    with Stranger(at.domain) as stranger:
        at.stranger = stranger
        if attack.stopped_before:
            stranger.publisher(topics.COMMAND).publish(full_throttle(at))
            time.sleep(0.3)
            at.new_lines()
        at.begun = None
        attack.run(at)
        at.begin()
        at.wait(lambda speed: speed < STANDS_MPS, STAND_WITHIN_S)
    time.sleep(WATCHED_S)
    assert at.begun is not None
    started, before = at.begun
    seen = at.watcher.since(started)
    stand_s = next((since for since, speed in seen if abs(speed) < STANDS_MPS), None)
    largest = max((abs(speed) for _, speed in seen), default=0.0)
    again = stand_s is not None and any(abs(speed) > 2 * STANDS_MPS for since, speed in seen if since > stand_s)
    lines = at.new_lines()
    allowed = REACTION_S + largest / attack.brakes_mps2
    return Outcome(attack.name, before, largest, stand_s, allowed, again, lines[0] if lines else '')


def run_attacks(
    folder: Path, domain: int, bundle: Path, chosen: Sequence[Attack], seed: int, on_outcome: Callable[[Outcome], None]
) -> list[Outcome]:
    """Carry the attacks out one after another, on a new graph where the last one has left none that drives."""
    found: list[Outcome] = []
    left = list(chosen)
    for number in itertools.count():
        if not left:
            return found
        with scene(folder / f'graph_{number}', domain, bundle, seed + number) as at:
            done = 0
            try:
                for attack in left:
                    outcome = carry_out(at, attack)
                    found.append(outcome)
                    on_outcome(outcome)
                    done += 1
            except GraphError:
                if not done:
                    raise
        left = left[done:]
    raise AssertionError
