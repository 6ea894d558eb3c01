"""What stands and walks beside the road without taking part: parked cars, and people on the sidewalk.

They have their places for the whole drive; only those near the ego are in the world.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Look, StandingObject, Walker, fork_of
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.roads import RoadMap
from raw2drive_ros.simulation.scenario import BackgroundSpec

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import Actor
    from raw2drive_ros.simulation.world import World

# Actors beside the road are in the world within this distance of the ego, with slack so that they do not flicker.
NEAR_M, FAR_M = 115.0, 130.0
# A parked car stands this far from the lane; its place is this long.
KERB_M, PLACE_M = 0.35, 7.0
# Nothing is parked this near a junction, and nothing is placed this near the actors of the scene.
JUNCTION_M, CLEAR_M = 14.0, 9.0
# People walk this far from the lane, beyond the parked cars, on stretches of their own.
SIDEWALK_M, STRETCH_M = 3.0, 22.0
WALK_MPS = (0.9, 1.6)
STANDS_SHARE = 0.3
VAN_SHARE = 0.15


class Bystander(Walker):
    """A person on the sidewalk who walks to and fro between two arc lengths of a path, or stands (0 m/s)."""

    def __init__(
        self, path: Path, between_m: tuple[float, float], s_m: float, lateral_m: float, speed_mps: float, look: Look
    ) -> None:
        super().__init__(path, s_m, lateral_m, lateral_m + 1.0, 1.0, 0.0, 'walker', look)
        self.path, self.between_m = path, between_m
        self.s_m, self.lateral_m, self.walk_mps = s_m, lateral_m, speed_mps
        self.speed = abs(speed_mps)
        self.left_to_walk_m = 0.0
        if speed_mps != 0.0:
            self.step(0.0)

    def think(self, world: World) -> None:
        """Turn back at the ends of the stretch."""
        low, high = self.between_m
        if (self.walk_mps > 0.0 and self.s_m > high) or (self.walk_mps < 0.0 and self.s_m < low):
            self.walk_mps = -self.walk_mps

    def step(self, dt: float) -> None:
        if self.walk_mps == 0.0:
            return
        self.s_m += self.walk_mps * dt
        x, y, yaw = self.path.pose(self.s_m, self.lateral_m)
        self.position[0], self.position[1] = x, y
        self.heading = yaw if self.walk_mps > 0.0 else yaw + math.pi


class Roadside:
    """All that is beside the road of a world, and which of it is in the world now."""

    def __init__(self, actors: list[Actor]) -> None:
        self.actors = actors
        self.places_m: Float64 = np.array([actor.position for actor in actors]).reshape(-1, 2)
        self.inside = np.zeros(len(actors), bool)

    def fork(self) -> Roadside:
        """An independent copy, without the actors themselves: the world forks those that are in it."""
        fork = Roadside.__new__(Roadside)
        fork.actors, fork.places_m, fork.inside = self.actors, self.places_m, self.inside.copy()
        return fork

    def update(self, world: World) -> None:
        """Bring in what has come near, take out what is far away."""
        if not self.actors:
            return
        far = np.hypot(*(self.places_m - world.ego.position).T)
        for index in np.flatnonzero(~self.inside & (far < NEAR_M)).tolist():
            actor = self.actors[index]
            # In a fork the actor must not change: it belongs to the world that was forked.
            world.add(fork_of(actor) if world.is_fork else actor)
            self.inside[index] = True
        for index in np.flatnonzero(self.inside & (far > FAR_M)).tolist():
            actor = world.find(self.actors[index].number)
            if actor is not None:
                world.remove(actor)
            self.inside[index] = False


def place_roadside(
    road: RoadMap, spec: BackgroundSpec, taken_m: Float64, parked_sides: str, rng: Rng, split: str
) -> list[Actor]:
    """Parked cars and people along the ego's road.

    taken_m: (N, 2) places of the scene's own actors. parked_sides: names the sides with parked cars, right and left.
    split: whose bodies and paints they have.
    """
    found: list[Actor] = []
    layout = road.layout
    sides = [(road.forward_path(layout.forward_lanes - 1), 'right')]
    if layout.backward_lanes:
        sides.append((road.backward_path(layout.backward_lanes - 1), 'left'))
    for path, side in sides:
        open_m = _open_stations(road, path, taken_m)
        if side in parked_sides:
            found += _parked(path, open_m, spec.parked, layout.lane_width_m / 2, rng, split)
        beside = max(SIDEWALK_M, layout.parking_width_m(side) + layout.shoulder_m + 1.0)
        found += _people(path, open_m, spec.bystanders, layout.lane_width_m / 2 + beside, rng, split)
    return found


def _open_stations(road: RoadMap, path: Path, taken_m: Float64) -> Float64:
    """Arc lengths, a metre apart, away from junctions, ramps and from the scene's own actors."""
    stations = np.arange(path.start_s_m + 2.0, path.length_m - 2.0, 1.0)
    points = np.array([path.pose(float(s), -2.0)[:2] for s in stations])
    free = np.ones(len(stations), bool)
    for site in road.junctions:
        free &= np.hypot(*(points - site.centre_m).T) > site.half_size_m * math.sqrt(2.0) + JUNCTION_M
    for edge in (*road.ramp, *road.exit):
        for x, y in road.lane(edge, 0).centre_line(4.0):
            free &= np.hypot(points[:, 0] - x, points[:, 1] - y) > CLEAR_M
    for place in taken_m:
        free &= np.hypot(*(points - place).T) > CLEAR_M
    return stations[free]


def _parked(path: Path, open_m: Float64, share: float, half_m: float, rng: Rng, split: str) -> list[Actor]:
    found: list[Actor] = []
    free = set(open_m.tolist())
    for s_m in np.arange(path.start_s_m + 6.0, path.length_m - 6.0, PLACE_M).tolist():
        takes, van, shift = rng.random(3).tolist()
        kind = 'parked_van' if van < VAN_SHARE else 'parked'
        look = Look.draw(kind, rng, split)
        if takes >= share or not {s_m - 3.0, s_m, s_m + 3.0} <= free:
            continue
        actor = StandingObject(0.0, 0.0, 0.0, kind, look)
        lateral = -(half_m + KERB_M + actor.WIDTH / 2)
        x, y, yaw = path.pose(s_m + 0.6 * (shift - 0.5), lateral)
        actor.position[:] = (x, y)
        actor.heading = yaw
        found.append(actor)
    return found


def _people(path: Path, open_m: Float64, per_100_m: int, beside_m: float, rng: Rng, split: str) -> list[Actor]:
    found: list[Actor] = []
    free = set(open_m.tolist())
    for begin in np.arange(path.start_s_m + 2.0, path.length_m - STRETCH_M, STRETCH_M + 2.0).tolist():
        comes, stands, at, side, speed = rng.random(5).tolist()
        look = Look.draw('walker', rng, split)
        whole = all(begin + k in free for k in range(int(STRETCH_M)))
        if comes >= per_100_m * (STRETCH_M + 2.0) / 100.0 / 2.0 or not whole:
            continue
        walk = 0.0 if stands < STANDS_SHARE else WALK_MPS[0] + (WALK_MPS[1] - WALK_MPS[0]) * speed
        between = (begin, begin + STRETCH_M)
        found.append(
            Bystander(
                path,
                between,
                begin + at * STRETCH_M,
                -beside_m,
                walk if side < 0.5 else -walk,
                look,
            )
        )
    return found
