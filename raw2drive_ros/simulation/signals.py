"""State of traffic lights and stop signs along the route."""

from __future__ import annotations

from dataclasses import dataclass, field

STOP_SPEED_MPS = 0.1
STOP_SIGN_RANGE_M = 4.0


@dataclass(slots=True)
class TrafficLight:
    """A traffic light for the ego's approach; cross traffic has green exactly while it is red for the ego.

    line_s_m: arc length of the stop line on the route. phases: (colour, duration s), run through once the ego is
    within `trigger_m` of the line; the light shows the first colour before that, and the last one for ever after.
    pole_pose: x, y, yaw in `map`.
    """

    line_s_m: float
    phases: tuple[tuple[str, float], ...]
    trigger_m: float = 45.0
    pole_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    started_s: float | None = field(default=None, init=False)
    colour: str = field(default='', init=False)

    def __post_init__(self) -> None:
        self.colour = self.phases[0][0]

    def update(self, time_s: float, route_s_m: float) -> None:
        if self.started_s is None and self.line_s_m - route_s_m < self.trigger_m:
            self.started_s = time_s
        if self.started_s is None:
            return
        left = time_s - self.started_s
        for colour, seconds in self.phases:
            self.colour = colour
            left -= seconds
            if left < 0:
                return


@dataclass(slots=True)
class StopSign:
    """A stop sign, obeyed once the ego has stopped within `STOP_SIGN_RANGE_M` before its line."""

    line_s_m: float
    pole_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    obeyed: bool = field(default=False, init=False)

    def update(self, front_s_m: float, speed_mps: float) -> None:
        if abs(speed_mps) < STOP_SPEED_MPS and 0.0 <= self.line_s_m - front_s_m < STOP_SIGN_RANGE_M:
            self.obeyed = True
