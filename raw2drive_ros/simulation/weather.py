"""Weather presets: how light, clouds, rain, fog and night change the camera images, and nothing else.

Names follow CARLA's presets: three times of day by seven conditions, and two with fog; 23, as many as Bench2Drive uses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raw2drive_ros.contracts.errors import UnknownWeatherError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.contracts.public import Float64

# Range of the ego's headlights, and growth of the beam's half width per metre.
BEAM_M, BEAM_SPREAD = 24.0, 0.5
LAMPS_AHEAD_M = 2.0
# Lit lamps are visible through so many times as much fog as other surfaces.
LAMP_REACH = 3.0


@dataclass(frozen=True, slots=True)
class Weather:
    """light: brightness of surfaces that are not emissive (1 = noon). sun: share of directional light. warmth: red gain
    minus blue gain. fog_m: visibility, at which contrast has fallen to 1/e (inf = none). rain: share of pixels hit by
    streaks. wet: how dark and shiny the road is, [0, 1]. noise: standard deviation of pixel noise in grey levels of
    255. headlights: brightness in the beam of the ego's headlights, added to `light` (0 = off). sky_top, sky_horizon:
    RGB, [0, 255].
    """

    name: str
    light: float = 1.0
    sun: float = 1.0
    warmth: float = 0.0
    fog_m: float = float('inf')
    rain: float = 0.0
    wet: float = 0.0
    noise: float = 0.0
    headlights: float = 0.0
    sky_top: tuple[float, float, float] = (110.0, 155.0, 215.0)
    sky_horizon: tuple[float, float, float] = (200.0, 212.0, 222.0)

    def tint(self) -> Float64:
        """(3,) RGB gain of white light."""
        return np.array([1.0 + self.warmth / 2, 1.0, 1.0 - self.warmth / 2])

    def beam(self, ego_xy: Float64) -> Float64:
        """(...,) brightness that the ego's headlights add at (..., 2) points in the ego frame."""
        ahead = np.maximum(ego_xy[..., 0] - LAMPS_AHEAD_M, 0.0)
        across = ego_xy[..., 1] / (BEAM_SPREAD * ahead + 1.0)
        rising = np.minimum(ahead / 2.0, 1.0)
        return self.headlights * rising * np.clip(1.3 - across * across, 0.0, 1.0) * np.exp(-ahead / BEAM_M)


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


def _dimmed(colour: tuple[float, float, float], by: float) -> tuple[float, float, float]:
    return colour[0] * by, colour[1] * by, colour[2] * by


def _presets() -> dict[str, Weather]:
    found = {}
    for time in ('Noon', 'Sunset', 'Night'):
        for condition, fields in _CONDITIONS.items():
            weather = Weather(f'{condition}{time}', **fields)
            # The sky of a sunset is darker under clouds.
            glow = weather.light
            if time == 'Sunset':
                weather = replace(
                    weather,
                    light=0.75 * weather.light,
                    warmth=0.1 + 0.2 * weather.sun,
                    noise=weather.noise + 1.0,
                    sky_top=_dimmed((120.0, 110.0, 140.0), glow),
                    sky_horizon=_dimmed((235.0, 160.0, 105.0), glow),
                )
            elif time == 'Night':
                weather = replace(
                    weather,
                    light=0.42 * (0.4 + 0.6 * weather.light),
                    sun=0.0,
                    warmth=-0.1,
                    noise=weather.noise + 2.0,
                    headlights=0.5,
                    sky_top=(8.0, 10.0, 20.0),
                    sky_horizon=(24.0, 28.0, 40.0),
                )
            found[weather.name] = weather
    for time in ('Noon', 'Sunset'):
        found[f'Fog{time}'] = replace(found[f'Cloudy{time}'], name=f'Fog{time}', fog_m=35.0)
    return found


WEATHERS = _presets()
WEATHER_NAMES = tuple(WEATHERS)


def get_weather(name: str) -> Weather:
    """The preset called `name`. Raises UnknownWeatherError."""
    if name not in WEATHERS:
        raise UnknownWeatherError(unknown_name('weather', name, WEATHER_NAMES))
    return WEATHERS[name]
