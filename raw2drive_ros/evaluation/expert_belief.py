"""What the expert believes about others: what it has seen of them, and nothing else.

An actor is known by its class, box, pose, speed, brake lamps and indicator as they were when it was last seen; what has
not been seen for `MEMORY_S` is forgotten. Scripts, targets, paths and traffic to come are never read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Protocol

from raw2drive_ros.simulation.world import World

MEMORY_S = 2.0
# Weight of the newest difference of two speeds in the estimated acceleration.
SMOOTHING = 0.45
STANDING_MPS = 0.25
# Classes that stay where they are, and those that move on their feet or on two wheels.
FIXED = frozenset(('parked', 'parked_van', 'parked_emergency', 'barrier', 'cone', 'door', 'board'))
SOFT = frozenset(('walker', 'cyclist'))


class Sight(Protocol):
    """What the expert needs of `simulation.visibility.Visibility`."""

    def seconds_since_seen(self, actor: Any) -> float:
        """0 while the actor is seen, inf if it never was."""

    def light_seen_s(self, index: int) -> float:
        """Seconds since that light was seen."""

    def sign_seen_s(self, index: int) -> float:
        """Seconds since that stop sign was seen."""


@dataclass(slots=True)
class Track:
    """One actor as it was last seen. standing_s: how long it has been standing. swerve_radps: its heading's change."""

    number: int
    kind: str
    length_m: float
    width_m: float
    height_m: float
    x: float
    y: float
    yaw: float
    speed: float
    seen_s: float
    acceleration: float = 0.0
    swerve_radps: float = 0.0
    braking: bool = False
    indicator: str = ''
    standing_s: float = 0.0
    ever_moved: bool = False

    @property
    def fixed(self) -> bool:
        return self.kind in FIXED

    @property
    def name(self) -> str:
        return f'{self.kind} {self.number}'


@dataclass(slots=True)
class Belief:
    """tracks: number of an actor -> what is known of it. colours: index of a light -> (colour, when it was seen)."""

    tracks: dict[int, Track] = field(default_factory=dict)
    colours: dict[int, tuple[str, float]] = field(default_factory=dict)
    signs: set[int] = field(default_factory=set)
    numbers: dict[int, int] = field(default_factory=dict)
    time_s: float = -1.0

    def update(self, world: World, sight: Sight) -> None:
        """Take in what is seen now. Call it once per decision."""
        step_s = world.time_s - self.time_s
        self.time_s = world.time_s
        for actor in world.actors:
            if sight.seconds_since_seen(actor) > 0.0:
                continue
            number = self._number(actor)
            new = _seen(actor, number, world.time_s)
            if number in self.tracks:
                _follow(new, self.tracks[number], step_s)
            self.tracks[number] = new
        for number in [n for n, track in self.tracks.items() if world.time_s - track.seen_s > MEMORY_S]:
            del self.tracks[number]
        for track in self.tracks.values():
            if track.seen_s < world.time_s:
                _extrapolate(track, step_s)
        for i, light in enumerate(world.lights):
            if sight.light_seen_s(i) == 0.0:
                self.colours[i] = (light.colour, world.time_s)
        self.signs |= {i for i in range(len(world.stop_signs)) if sight.sign_seen_s(i) < math.inf}

    def colour(self, index: int) -> str | None:
        """Colour of a light if it was seen in the last `MEMORY_S`, else None."""
        colour, seen_s = self.colours.get(index, ('', -math.inf))
        return colour if self.time_s - seen_s <= MEMORY_S else None

    def _number(self, actor: Any) -> int:
        number = getattr(actor, 'number', None)
        if number is None:
            return self.numbers.setdefault(id(actor), len(self.numbers))
        return int(number)


def _seen(actor: Any, number: int, time_s: float) -> Track:
    x, y = float(actor.position[0]), float(actor.position[1])
    return Track(
        number,
        actor.kind,
        actor.LENGTH,
        actor.WIDTH,
        actor.HEIGHT,
        x,
        y,
        float(actor.heading),
        float(actor.speed),
        time_s,
        braking=bool(getattr(actor, 'braking', False)),
        indicator=str(getattr(actor, 'indicator', '')),
    )


def _follow(new: Track, old: Track, step_s: float) -> None:
    """What follows from two sightings of the same actor: acceleration, turning, how long it has been standing."""
    if step_s > 0.0:
        rate = min(max((new.speed - old.speed) / step_s, -9.0), 4.0)
        new.acceleration = old.acceleration + SMOOTHING * (rate - old.acceleration)
        turn = math.remainder(new.yaw - old.yaw, 2.0 * math.pi) / step_s
        new.swerve_radps = old.swerve_radps + SMOOTHING * (turn - old.swerve_radps)
    standing = new.speed < STANDING_MPS
    new.standing_s = old.standing_s + step_s if standing else 0.0
    new.ever_moved = old.ever_moved or not standing


def _extrapolate(track: Track, step_s: float) -> None:
    """A hidden actor goes on as it was."""
    track.x += track.speed * math.cos(track.yaw) * step_s
    track.y += track.speed * math.sin(track.yaw) * step_s
    track.acceleration = 0.0
