"""State of traffic lights and stop signs: those that the ego has to obey, and the lamps of all approaches."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

GREEN, YELLOW, RED = 'green', 'yellow', 'red'
STOP_SPEED_MPS = 0.1
STOP_SIGN_RANGE_M = 4.0
AMBER_S = 3.0
# All approaches are red for so long before any of them turns green.
ALL_RED_S = 1.5
MIN_GREEN_S = 3.0
PolePose = tuple[float, float, float]


@dataclass(slots=True)
class TrafficLight:
    """The light of a junction, programmed for the ego's approach.

    line_s_m: arc length of the ego's stop line on the route. phases: (green or red, duration s), run through once the
    ego is within `trigger_m` of the line; the light shows the first one before that. After the last one it keeps its
    colour, or with `repeats` begins again. Amber for the last `AMBER_S` before red belongs to the red phase, so a
    green phase is as long as it says. pole_pose: x, y, yaw in `map`. junction: its number. held: arms that stay red
    while the ego has green, e.g. ('ahead',) for a protected left turn.
    """

    line_s_m: float
    phases: tuple[tuple[str, float], ...]
    trigger_m: float = 45.0
    pole_pose: PolePose = (0.0, 0.0, 0.0)
    junction: int = 0
    held: tuple[str, ...] = ()
    repeats: bool = False
    started_s: float | None = field(default=None, init=False)
    colour: str = field(default='', init=False)
    cross_colour: str = field(default='', init=False)

    def __post_init__(self) -> None:
        self.update(0.0, -math.inf)

    def update(self, time_s: float, front_s_m: float) -> None:
        """front_s_m: arc length of the ego's front bumper on the route."""
        if self.started_s is None and self.line_s_m - front_s_m < self.trigger_m:
            self.started_s = time_s
        self.colour, self.cross_colour = self._colours(None if self.started_s is None else time_s - self.started_s)

    def colour_for(self, arm: str) -> str:
        """The colour that an approach sees: back and ahead together, left and right together."""
        if arm in ('left', 'right'):
            return self.cross_colour
        if arm in self.held and self.colour != RED:
            return RED
        return self.colour

    def _colours(self, since_s: float | None) -> tuple[str, str]:
        """(of the ego's approach, of the approaches across) so many seconds after the start of the first phase."""
        if since_s is None:
            first = self.phases[0][0]
            return first, RED if first == GREEN else GREEN
        before, begin, phase = '', 0.0, 0
        if self.repeats:
            whole = sum(length for _, length in self.phases)
            before = self.phases[-1][0] if since_s >= whole else ''
            since_s %= whole
        while True:
            colour, length = self.phases[phase]
            last = phase == len(self.phases) - 1 and not self.repeats
            if last or since_s < begin + length:
                following = '' if last else self.phases[(phase + 1) % len(self.phases)][0]
                left = math.inf if last else begin + length - since_s
                return self._within(colour, before, following, since_s - begin, left)
            before, begin, phase = colour, begin + length, phase + 1

    @staticmethod
    def _within(colour: str, before: str, following: str, since_s: float, left_s: float) -> tuple[str, str]:
        if colour == GREEN:
            return GREEN, RED
        amber = AMBER_S if before == GREEN else 0.0
        if since_s < amber:
            return YELLOW, RED
        # Red for the ego: the approaches across are green from after all-red until their own amber and all-red.
        begins = amber + ALL_RED_S if before == GREEN else 0.0
        ends = left_s - ALL_RED_S - AMBER_S if following == GREEN else math.inf
        whole = since_s + ends - begins
        if since_s < begins or (before == GREEN and whole < MIN_GREEN_S):
            return RED, RED
        if ends > 0.0:
            return RED, GREEN
        return RED, YELLOW if left_s > ALL_RED_S else RED


@dataclass(slots=True)
class StopSign:
    """A stop sign, obeyed once the ego has stopped within `STOP_SIGN_RANGE_M` before its line."""

    line_s_m: float
    pole_pose: PolePose = (0.0, 0.0, 0.0)
    obeyed: bool = field(default=False, init=False)

    def update(self, front_s_m: float, speed_mps: float) -> None:
        if abs(speed_mps) < STOP_SPEED_MPS and 0.0 <= self.line_s_m - front_s_m < STOP_SIGN_RANGE_M:
            self.obeyed = True


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp that one approach of a junction sees. pole_pose: x, y, yaw in `map`; yaw is where it looks."""

    pole_pose: PolePose
    colour: str
    junction: int
    arm: str


@dataclass(frozen=True, slots=True)
class Sign:
    """A traffic sign. kind: stop or yield. pole_pose: x, y, yaw in `map`; yaw is where it looks."""

    kind: str
    pole_pose: PolePose
    junction: int
    arm: str
