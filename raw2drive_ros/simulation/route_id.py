"""The identifier of one drive: scenario type, event or twin, seed, weather and repetition."""

from __future__ import annotations

import re
from dataclasses import dataclass

from raw2drive_ros.contracts.errors import RouteIdError
from raw2drive_ros.simulation.weather import CLEAR, get_weather

# Not `isdigit`, which accepts a superscript two; 18 digits fit into an integer parameter of ROS.
TWIN = '-twin'
NUMBER = re.compile(r'[0-9]{1,18}')


@dataclass(frozen=True, slots=True, order=True)
class RouteId:
    """repetition: 0 is the route as drawn; others start a little beside it and have other sensor noise. twin: the drive
    that looks alike, but in which what the type is about does not happen."""

    type: str
    seed: int
    weather: str = CLEAR
    repetition: int = 0
    twin: bool = False

    def __str__(self) -> str:
        parts = [self.type + TWIN * self.twin, str(self.seed)]
        if self.weather != CLEAR or self.repetition:
            parts.append(self.weather)
        if self.repetition:
            parts.append(str(self.repetition))
        return '/'.join(parts)

    @staticmethod
    def parse(text: str) -> RouteId:
        """'Accident/3', 'Accident-twin/3', 'Accident/3/CloudyNight' or 'Accident/3/CloudyNight/1'.

        Raises RouteIdError, UnknownWeatherError; the type's name is not looked up.
        """
        name, *rest = text.strip().split('/')
        if not name or not 1 <= len(rest) <= 3 or not all(NUMBER.fullmatch(part) for part in (rest[0], *rest[2:])):
            raise RouteIdError(
                f'{text!r} is not of the form TYPE/SEED, TYPE/SEED/WEATHER or TYPE/SEED/WEATHER/REPETITION'
            )
        weather = get_weather(rest[1]).name if len(rest) > 1 else CLEAR
        kind = name.removesuffix(TWIN)
        return RouteId(kind, int(rest[0]), weather, int(rest[2]) if len(rest) > 2 else 0, kind != name)
