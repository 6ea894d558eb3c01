"""Weathers: what light, cloud, rain, fog and night do to the camera images, and to nothing else.

Names follow CARLA's presets, three times of day by seven conditions, and two with fog: 23, as many as
Bench2Drive cycles through.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


class UnknownWeatherError(ValueError):
    """No weather of that name; the message lists the known ones."""


@dataclass(frozen=True, slots=True)
class Weather:
    """light: brightness of everything that does not shine by itself (1 = noon). sun: share of directed light.
    warmth: red gain minus blue gain. fog_m: visibility, at which contrast has fallen to 1/e (inf = none).
    rain: share of pixels hit by streaks. wet: how dark and shiny the road is, [0, 1]. noise: standard
    deviation of pixel noise in grey levels of 255. sky_top, sky_horizon: RGB, [0, 255].
    """

    name: str
    light: float = 1.0
    sun: float = 1.0
    warmth: float = 0.0
    fog_m: float = float('inf')
    rain: float = 0.0
    wet: float = 0.0
    noise: float = 0.0
    sky_top: tuple[float, float, float] = (110.0, 155.0, 215.0)
    sky_horizon: tuple[float, float, float] = (200.0, 212.0, 222.0)


CLEAR = 'ClearNoon'
_GREY = {'sky_top': (150.0, 156.0, 165.0), 'sky_horizon': (190.0, 193.0, 197.0)}
_CONDITIONS = {
    'Clear': {},
    'Cloudy': {'light': 0.85, 'sun': 0.25, **_GREY},
    'Wet': {'wet': 0.6},
    'WetCloudy': {'light': 0.82, 'sun': 0.25, 'wet': 0.6, **_GREY},
    'SoftRain': {'light': 0.78, 'sun': 0.2, 'wet': 0.7, 'rain': 0.004, 'fog_m': 250.0, 'noise': 1.5, **_GREY},
    'MidRain': {'light': 0.7, 'sun': 0.1, 'wet': 0.85, 'rain': 0.010, 'fog_m': 140.0, 'noise': 2.5, **_GREY},
    'HardRain': {'light': 0.62, 'sun': 0.0, 'wet': 1.0, 'rain': 0.020, 'fog_m': 80.0, 'noise': 4.0, **_GREY},
}


def _presets() -> dict[str, Weather]:
    found = {}
    for time in ('Noon', 'Sunset', 'Night'):
        for condition, fields in _CONDITIONS.items():
            weather = Weather(f'{condition}{time}', **fields)
            if time == 'Sunset':
                weather = replace(
                    weather,
                    light=0.75 * weather.light,
                    warmth=0.25,
                    noise=weather.noise + 1.0,
                    sky_top=(120.0, 110.0, 140.0),
                    sky_horizon=(235.0, 160.0, 105.0),
                )
            elif time == 'Night':
                weather = replace(
                    weather,
                    light=0.32 * weather.light,
                    sun=0.0,
                    warmth=-0.08,
                    noise=weather.noise + 4.0,
                    sky_top=(8.0, 10.0, 20.0),
                    sky_horizon=(22.0, 26.0, 38.0),
                )
            found[weather.name] = weather
    for time in ('Noon', 'Sunset'):
        found[f'Fog{time}'] = replace(found[f'Cloudy{time}'], name=f'Fog{time}', fog_m=35.0)
    return found


WEATHERS = _presets()
WEATHER_NAMES = tuple(WEATHERS)


def get_weather(name: str) -> Weather:
    """Raises UnknownWeatherError."""
    if name not in WEATHERS:
        raise UnknownWeatherError(f'unknown weather {name!r}; known: {", ".join(WEATHER_NAMES)}')
    return WEATHERS[name]
