"""Finds the leading actor on each vehicle's path.

One search for all vehicles at once, at the decision rate, because this takes most of the time of a physics step: the
front of each vehicle is moved along its path in steps of `STEP_M`, and tested against the boxes of the actors nearby.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.path import SPACING_M, Path

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import PathVehicle
    from raw2drive_ros.simulation.world import World

LOOK_AHEAD_M = 50.0
MARGIN_M = 0.3
ALIGNED_COS = 0.75
STANDING_MPS = 0.5
# Distance between the places along its way at which a vehicle's front is tested.
STEP_M = 2.0
HALF_STEP_M = STEP_M / 2
STRIDE = round(STEP_M / SPACING_M)
STEPS = int(LOOK_AHEAD_M / STEP_M)
# Paths are known this far beyond their ends.
BEYOND_END_M = 100.0
NO_HIT = 10_000
# Actors farther behind a vehicle's centre than this, as the vehicle looks, cannot be on its way.
BEHIND_M = 8.0
HEAD_ON_COS = -0.7
# Vehicles brake for where a walker will be within this time.
WALK_AHEAD_S = 2.0
NOBODY = (math.inf, 0.0, -1)
# Where there is no actor.
FAR_M = 1e12

Ints = NDArray[Any]


class PathBank:
    """The points of all paths that vehicles follow, one after another. It only grows, so forks share it."""

    def __init__(self) -> None:
        # (first row, last row) of each path; the paths themselves are kept so that their identities stay theirs.
        self.rows: dict[int, tuple[int, int]] = {}
        self.paths: list[Path] = []
        self.table: Float64 = np.zeros((0, 4))

    def rows_of(self, path: Path) -> tuple[int, int]:
        """(first, last) row of a path in `table`, whose columns are x, y, cos and sin of the heading."""
        found = self.rows.get(id(path))
        if found is None:
            yaw = path.headings_rad
            new = np.column_stack([path.points_m, np.cos(yaw), np.sin(yaw)])
            # Straight on beyond the end, as `Path.pose` goes on: vehicles leave where nobody sees it.
            beyond = np.arange(1, round(BEYOND_END_M / SPACING_M) + 1)[:, None] * SPACING_M
            end = np.tile(new[-1], (len(beyond), 1))
            end[:, :2] += beyond * new[-1, 2:]
            new = np.concatenate([new, end])
            found = self.rows[id(path)] = (len(self.table), len(self.table) + len(new) - 1)
            self.paths.append(path)
            self.table = np.concatenate([self.table, new])
        return found


class _Part(NamedTuple):
    """Who looks for leaders in one world. rows: of the followers in the world's arrays."""

    world: World
    followers: Sequence[PathVehicle]
    rows: list[int]


def find_leaders(world: World, vehicles: Sequence[PathVehicle]) -> None:
    """Set `gap_m`, `closing_mps`, `leader_row` (of the world's arrays) of each vehicle to the leading actor on its
    path, and `others_gap_m`, `others_closing_mps` to the leading one but the ego; (inf, 0, -1) without one.

    Vehicles that ignore traffic are left out.
    """
    find_leaders_in([(world, vehicles)])


def find_leaders_in(groups: Sequence[tuple[World, Sequence[PathVehicle]]]) -> None:
    """`find_leaders` in several worlds at once, which takes less time than one after the other."""
    parts = []
    for world, vehicles in groups:
        followers = [vehicle for vehicle in vehicles if not vehicle.ignores_traffic]
        for vehicle in followers:
            vehicle.gap_m, vehicle.closing_mps, vehicle.leader_row = NOBODY
            vehicle.others_gap_m, vehicle.others_closing_mps = math.inf, 0.0
        if followers:
            parts.append(_Part(world, followers, [world.index_of(vehicle) for vehicle in followers]))
    if parts:
        _Search(parts).run()


def _joined(arrays: Sequence[Any]) -> Any:
    """Arrays of several worlds one after another; that of a single one as it is."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _padded(arrays: Sequence[Any], fill: float) -> Any:
    """(W, N, ...) of W arrays, the shorter ones filled up to the longest."""
    if len(arrays) == 1:
        return arrays[0][None]
    padded = np.full((len(arrays), max(map(len, arrays)), *arrays[0].shape[1:]), fill, arrays[0].dtype)
    for row, array in zip(padded, arrays):
        row[: len(array)] = array
    return padded


class _Search:
    """The arrays of all parts one after another: rows of actors and of followers are counted on."""

    def __init__(self, parts: Sequence[_Part]) -> None:
        self.parts = parts
        worlds = [part.world for part in parts]
        self.first_row = np.cumsum([0, *(len(world.positions) for world in worlds)])
        self.first_follower = np.cumsum([0, *(len(part.rows) for part in parts)])
        own_rows = [np.array(part.rows) for part in parts]
        self.rows = _joined([rows + begin for rows, begin in zip(own_rows, self.first_row)])
        self.positions, self.headings, self.speeds, self.half_widths, self.half_lengths, self.walks = (
            _joined([getattr(world, name) for world in worlds])
            for name in ('positions', 'headings', 'speeds', 'half_widths', 'half_lengths', 'walks')
        )
        # The ego of each world is its last row.
        self.margins = np.full(len(self.positions), MARGIN_M)
        self.margins[self.first_row[1:] - 1] = [MARGIN_M * (world.ego.speed <= STANDING_MPS) for world in worlds]
        self.one, self.other = self._pairs(own_rows)

    def _pairs(self, own_rows: list[Ints]) -> tuple[Ints, Ints]:
        """(K,) followers, and (K,) rows of the actors that may be on the way of each."""
        positions = _padded([part.world.positions for part in self.parts], FAR_M)
        rows = _padded(own_rows, 0)
        world = np.arange(len(rows))[:, None]
        x, y = positions[..., 0], positions[..., 1]
        dx, dy = x[:, None] - x[world, rows][..., None], y[:, None] - y[world, rows][..., None]
        yaw = _padded([part.world.headings for part in self.parts], 0.0)[world, rows]
        ahead = dx * np.cos(yaw)[..., None] + dy * np.sin(yaw)[..., None]
        reach = LOOK_AHEAD_M + 2.0 * BEHIND_M
        near = (dx * dx + dy * dy < reach * reach) & (ahead > -BEHIND_M)
        near[world, np.arange(rows.shape[1]), rows] = False
        for found, own in zip(near, own_rows):
            found[len(own) :] = False
        of, one, other = np.nonzero(near)
        return one + self.first_follower[of], other + self.first_row[of]

    def run(self) -> None:
        """Find the first hit of each pair, and give it to the follower."""
        one, other = self.one, self.other
        if not len(one):
            return
        samples, residue = self._samples()
        x, y, cos, sin = (samples[one, :, k] for k in range(4))
        yaw = self.headings[other]
        other_cos, other_sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        # Who walks takes up the way ahead, too.
        half_walk = (0.5 * WALK_AHEAD_S * np.where(self.walks, self.speeds, 0.0))[other][:, None]
        dx = x - self.positions[other, 0, None] - half_walk * other_cos
        dy = y - self.positions[other, 1, None] - half_walk * other_sin
        # In the frame of the other actor, a cross-section of the follower reaches `across` * half its width from its
        # middle along the length of the other, and `along` * half its width along the width.
        along, across = np.abs(cos * other_cos + sin * other_sin), np.abs(sin * other_cos - cos * other_sin)
        half = (self.half_widths[self.rows][one] + self.margins[other])[:, None]
        # Half a step more along the way, so that nothing is missed between two samples.
        over_length = self.half_lengths[other][:, None] + half_walk + half * across + HALF_STEP_M * along
        over_length -= np.abs(dx * other_cos + dy * other_sin)
        over_width = self.half_widths[other][:, None] + half * along + HALF_STEP_M * across
        over_width -= np.abs(dy * other_cos - dx * other_sin)
        hits = (over_length > 0.0) & (over_width > 0.0)
        first = hits.argmax(axis=1)
        found = np.flatnonzero(hits[np.arange(len(one)), first])
        if not len(found):
            return
        at = first[found] * STEP_M
        hit = (found, first[found])
        one, other, along, across = one[found], other[found], along[hit], across[hit]
        # From the first sample that touches back to where the surfaces meet.
        deep = np.where(along > across, over_length[hit], over_width[hit]) / np.maximum(along, across)
        beyond_middle = dx[hit] * cos[hit] + dy[hit] * sin[hit]
        deep += 2.0 * np.maximum(beyond_middle, 0.0)
        gap = at + HALF_STEP_M - np.where(at > 0.0, np.minimum(deep, STEP_M), deep) - residue[one]
        facing = cos[hit] * other_cos[found, 0] + sin[hit] * other_sin[found, 0]
        closing = self.speeds[self.rows[one]] - self.speeds[other] * facing
        self._give(one, other, gap, closing, facing)

    def _samples(self) -> tuple[Float64, Float64]:
        """(V, STEPS, 4) x, y, cos and sin of the heading of each follower's front on its way, `STEP_M` apart, and (V,)
        how far the front is beyond the first of them already."""
        everyone = [vehicle for part in self.parts for vehicle in part.followers]
        ends = np.array([part.world.bank.rows_of(vehicle.path) for part in self.parts for vehicle in part.followers])
        front = np.array([vehicle.s_m for vehicle in everyone]) + self.half_lengths[self.rows]
        front -= np.array([vehicle.path.start_s_m for vehicle in everyone])
        begin = np.maximum(front / SPACING_M, 0.0).astype(int)
        index = np.minimum((ends[:, 0] + begin)[:, None] + STRIDE * np.arange(STEPS), ends[:, 1, None])
        splits = np.split(index, self.first_follower[1:-1])
        samples = _joined([part.world.bank.table[own] for part, own in zip(self.parts, splits)])
        aside = np.array([vehicle.lateral_m for vehicle in everyone])
        if aside.any():
            # A zero leaves a place as it is, bit for bit.
            samples[:, :, 0] -= aside[:, None] * samples[:, :, 3]
            samples[:, :, 1] += aside[:, None] * samples[:, :, 2]
        return samples, front - begin * SPACING_M

    def _give(self, one: Ints, other: Ints, gap: Float64, closing: Float64, facing: Float64) -> None:
        ends = np.searchsorted(one, self.first_follower)
        for i, part in enumerate(self.parts):
            own = slice(ends[i], ends[i + 1])
            rows = one[own] - self.first_follower[i], other[own] - self.first_row[i]
            columns = [column.tolist() for column in (*rows, gap[own], closing[own], facing[own])]
            _assign(part.world, part.followers, zip(*columns))


def _assign(world: World, followers: Sequence[PathVehicle], hits: Any) -> None:
    """hits: (follower, row of the other, gap, closing speed, cosine of their headings) of every hit."""
    ego = len(world.actors)
    moving = world.ego.speed >= STANDING_MPS
    for one, other, gap, closing, facing in hits:
        vehicle = followers[one]
        if facing < HEAD_ON_COS and closing > 0.0:
            # Head-on: each of them has to stop before the place where they would meet.
            gap, closing = gap * vehicle.speed / closing, vehicle.speed
        gap = max(gap, 0.05)
        if other == ego:
            # Vehicles with priority ignore an ego that crosses their way.
            if moving and (vehicle.ignores_ego or (vehicle.has_priority and facing < ALIGNED_COS)):
                continue
        elif gap < vehicle.others_gap_m:
            vehicle.others_gap_m, vehicle.others_closing_mps = gap, closing
        if gap < vehicle.gap_m:
            vehicle.gap_m, vehicle.closing_mps, vehicle.leader_row = gap, closing, other


def first_on_path(world: World, row: int, window_m: Float64, margin_m: float, reach_m: float) -> tuple[float, float]:
    """(free gap m, closing speed m/s) of the actor in row `row` of the world's arrays to the first actor that reaches
    into its corridor, or (inf, 0).

    window_m: (M, 2) points of its path ahead, 1 m apart. margin_m: clearance on either side. reach_m: only actors
    within this distance along either axis of `map` count.
    """
    near = (np.abs(world.positions - world.positions[row]) < reach_m).all(axis=1)
    near[row] = False
    columns = np.flatnonzero(near)
    if not len(columns) or not len(window_m):
        return math.inf, 0.0
    reach = world.half_widths[columns] + world.half_widths[row] + margin_m
    dx = world.positions[columns, 0, None] - window_m[None, :, 0]
    dy = world.positions[columns, 1, None] - window_m[None, :, 1]
    hits = dx * dx + dy * dy < (reach**2)[:, None]
    steps = np.where(hits.any(axis=1), hits.argmax(axis=1), NO_HIT)
    best = int(steps.argmin())
    if steps[best] == NO_HIT:
        return math.inf, 0.0
    other = columns[best]
    cos = math.cos(world.headings[row] - world.headings[other])
    gap = steps[best] + reach[best] * 0.5 - world.half_lengths[row] - world.half_lengths[other] * abs(cos)
    return max(float(gap), 0.05), float(world.speeds[row] - world.speeds[other] * cos)
