"""What the cameras show of every actor, light and sign, and when they showed it last.

The law. An actor is seen in a tick when at least one camera shows enough of it:

    pixels x clearness >= threshold

- pixels: of the final image that show it, counted in the id buffer (`id_painter`), so that what stands in front of it
  has been taken off. Shadows do not count. Of a light only its face counts, and of a sign its plate, from the front.
- threshold: `THRESHOLDS_PX` at 96 x 160 pixels, in proportion to the area of the image.
- clearness, between 0 and 1, is the product of
  - fog: exp(-distance / fog_m), the contrast that is left at that distance (`Weather.fog_m`);
  - rain: 1 - `RAIN_LOSS` x rain, the share of the image that streaks do not cover (`Weather.rain`);
  - night: the brightness where it stands, ambient light and the beam of the ego's headlights together, at most 1.
- Lit lamps show through the dark and through `LAMP_REACH` times as much fog: at night the brightness of a vehicle
  with lit lamps is at least `LIT_AT_NIGHT`, and lights (not signs) need no other light and have that reach.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Actor, PathVehicle
from raw2drive_ros.simulation.id_painter import Counts
from raw2drive_ros.simulation.weather import LAMP_REACH, Weather
from raw2drive_ros.simulation.world import World

# Area of the images for which the thresholds are.
THRESHOLD_IMAGE_PX = 96 * 160
# Pixels that an actor of a kind has to show. Kinds that are not listed are vehicles in motion.
VEHICLE_PX, OTHER_PX, SIGNAL_PX = 5.0, 10.0, 3.0
THRESHOLDS_PX = {
    'parked': OTHER_PX,
    'parked_van': OTHER_PX,
    'parked_emergency': OTHER_PX,
    'cyclist': OTHER_PX,
    'walker': OTHER_PX,
    'barrier': OTHER_PX,
    'cone': VEHICLE_PX,
    'door': VEHICLE_PX,
}
RAIN_LOSS = 10.0
LIT_AT_NIGHT = 0.8
MEMORY_S = 2.0


@dataclass(slots=True)
class _Sight:
    """actor: kept, so that its identity stays its own. seen_s: simulated time at which it was seen last."""

    actor: Actor
    pixels: Counts
    seen_s: float


class Visibility:
    """Account of one episode. `update` once per decision tick; all else answers for the moment of the last update.

    Actors are told apart by `actor.number` where they have one, otherwise by identity.
    """

    def __init__(self, weather: Weather, cameras: int = 6, image_px: int = THRESHOLD_IMAGE_PX) -> None:
        self.weather, self.cameras = weather, cameras
        self.scale = image_px / THRESHOLD_IMAGE_PX
        self.now_s = 0.0
        self._sights: dict[int, _Sight] = {}
        self._signals_seen_s: Float64 = np.zeros(0)
        self._lights = 0

    def update(self, world: World, counts: NDArray[np.integer], signal_counts: NDArray[np.integer]) -> None:
        """Take in what the cameras show now.

        counts: (actors, cameras) pixels in the order of `world.actors`. signal_counts: (lights and stop signs,
        cameras). Raises ValueError for other shapes.
        """
        actors = world.actors
        signals = len(world.lights) + len(world.stop_signs)
        if counts.shape != (len(actors), self.cameras) or signal_counts.shape != (signals, self.cameras):
            raise ValueError(
                f'Visibility.update: counts of {counts.shape} and {signal_counts.shape} for '
                f'{len(actors)} actors, {signals} lights and signs and {self.cameras} cameras'
            )
        self.now_s = world.time_s
        seen = self._seen(world, counts)
        before = self._sights
        # Actors that have left the world are forgotten.
        self._sights = {}
        for actor, pixels, is_seen in zip(actors, counts.astype(np.int32), seen.tolist(), strict=True):
            key = _key(actor)
            known = before.get(key)
            last_s = self.now_s if is_seen else -math.inf if known is None else known.seen_s
            self._sights[key] = _Sight(actor, pixels, last_s)
        self._update_signals(world, signal_counts)

    def pixels(self, actor: Actor) -> Counts:
        """(cameras,) pixels that show the actor; zeros for one that was not there at the last update."""
        sight = self._sights.get(_key(actor))
        return np.zeros(self.cameras, np.int32) if sight is None else sight.pixels.copy()

    def seconds_since_seen(self, actor: Actor) -> float:
        """0.0 while the actor is seen; infinite if it never was."""
        sight = self._sights.get(_key(actor))
        return math.inf if sight is None else self.now_s - sight.seen_s

    def rows(self, world: World, within_s: float = MEMORY_S) -> NDArray[np.bool_]:
        """(len(world.actors),) bool: which actors were seen within the last `within_s`."""
        return self.seen(world.actors, within_s)

    def seen(self, actors: list[Actor], within_s: float = MEMORY_S) -> NDArray[np.bool_]:
        """(len(actors),) bool: which of them were seen within the last `within_s`."""
        return np.array([self.seconds_since_seen(actor) <= within_s for actor in actors], bool)

    def light_seen_s(self, index: int) -> float:
        """Seconds since the face of `world.lights[index]` was seen; infinite if it never was."""
        return self._signal_seen_s(index)

    def sign_seen_s(self, index: int) -> float:
        """Seconds since the plate of `world.stop_signs[index]` was seen; infinite if it never was."""
        return self._signal_seen_s(self._lights + index)

    def signal_pixels(self) -> Counts:
        """(lights and stop signs, cameras) pixels that show them."""
        return self._signal_pixels.copy()

    # -- the law ----------------------------------------------------------------------------------

    def _seen(self, world: World, counts: NDArray[np.integer]) -> NDArray[np.bool_]:
        """(actors,) bool: what is seen now."""
        actors = world.actors
        if not actors:
            return np.zeros(0, bool)
        places = np.array([actor.position for actor in actors])
        lit = np.array([isinstance(actor, PathVehicle) and actor.kind != 'cyclist' for actor in actors])
        needed = np.array([THRESHOLDS_PX.get(actor.kind, VEHICLE_PX) for actor in actors])
        clear = self.clearness(_in_ego_frame(world, places), lit)
        enough: NDArray[np.bool_] = counts.max(axis=1, initial=0) * clear >= needed * self.scale
        return enough

    def clearness(self, ego_xy: Float64, lit: NDArray[np.bool_]) -> Float64:
        """(N,) share of pixels that the weather leaves of things at (N, 2) points in the ego frame.

        lit: (N,) bool, whether they carry lit lamps (by day that changes nothing).
        """
        weather = self.weather
        distance = np.hypot(ego_xy[:, 0], ego_xy[:, 1])
        clear = np.exp(-distance / weather.fog_m) * max(0.0, 1.0 - RAIN_LOSS * weather.rain)
        if weather.headlights:
            brightness = np.minimum(weather.light + weather.beam(ego_xy), 1.0)
            clear = clear * np.where(lit, np.maximum(brightness, LIT_AT_NIGHT), brightness)
        return clear

    def _update_signals(self, world: World, counts: NDArray[np.integer]) -> None:
        self._lights = len(world.lights)
        self._signal_pixels = counts.astype(np.int32)
        if len(self._signals_seen_s) != len(counts):
            self._signals_seen_s = np.full(len(counts), -math.inf)
        if not len(counts):
            return
        poles = [signal.pole_pose[:2] for signal in (*world.lights, *world.stop_signs)]
        places = _in_ego_frame(world, np.array(poles))
        clear = self.clearness(places, np.zeros(len(places), bool))
        rain = max(0.0, 1.0 - RAIN_LOSS * self.weather.rain)
        reach = np.exp(-np.hypot(places[:, 0], places[:, 1]) / (LAMP_REACH * self.weather.fog_m)) * rain
        clear[: self._lights] = reach[: self._lights]
        seen = counts.max(axis=1) * clear >= SIGNAL_PX * self.scale
        self._signals_seen_s[seen] = self.now_s

    def _signal_seen_s(self, index: int) -> float:
        return self.now_s - float(self._signals_seen_s[index])


def _key(actor: Actor) -> int:
    """A number that no other actor of the world has."""
    number = getattr(actor, 'number', -1)
    # Identities are negative here, so that they never equal a number.
    return int(number) if number >= 0 else -id(actor) - 1


def _in_ego_frame(world: World, points: Float64) -> Float64:
    """(N, 2) points of `map` in the ego's frame."""
    x, y, yaw = world.ego_history[0]
    cos, sin = math.cos(yaw), math.sin(yaw)
    moved: Float64 = (points - (x, y)) @ np.array([[cos, -sin], [sin, cos]])
    return moved
