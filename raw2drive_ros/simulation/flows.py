"""Streams of traffic as arrival times at a place: tight groups that nobody fits into, and gaps worth waiting for."""

from __future__ import annotations

from raw2drive_ros.simulation.scenario import Rng, TrafficSpec

# Where a vehicle that is not on the road yet drives in.
ENTRY_S_M = 1.0
# IDM settles below its target in a dense stream; this share keeps streams near the speed that they are drawn with.
IDM_SLACK = 1.12
TIGHT_GAP_S = 0.4


def group_times(
    rng: Rng,
    first_s: float,
    until_s: float,
    headway_s: tuple[float, float] = (1.4, 1.75),
    gap_s: tuple[float, float] = (6.5, 8.5),
    later_s: float = 5.0,
    groups: int = 2,
) -> list[float]:
    """Arrival times: a group from `first_s` to `until_s`, then `groups - 1` more of `later_s` seconds, gaps between."""
    times, now, end = [], first_s, until_s
    for _ in range(groups):
        while now < end:
            times.append(now)
            now += float(rng.uniform(*headway_s))
        now += float(rng.uniform(*gap_s))
        end = now + later_s
    return times


def arriving(
    times_s: list[float],
    on: str | tuple[str, str],
    place_s_m: float,
    speed_mps: float,
    lane: int = 0,
    kind: str = 'car',
    clear_m: tuple[float, float] = (0.0, 0.0),
    *,
    has_priority: bool = True,
    obeys_light: bool = False,
) -> tuple[TrafficSpec, ...]:
    """Vehicles that reach `place_s_m` of their path at those times; those not on the road yet drive in later.

    clear_m: nobody starts between these arc lengths (where the ego does).
    """
    cars = []
    for time_s in times_s:
        station = place_s_m - time_s * speed_mps
        if clear_m[0] < station < clear_m[1]:
            continue
        cars.append(
            TrafficSpec(
                on,
                max(station, ENTRY_S_M),
                speed_mps,
                lane=lane,
                target_speed_mps=IDM_SLACK * speed_mps,
                kind=kind,
                obeys_light=obeys_light,
                has_priority=has_priority,
                enters_at_s=max(0.0, (ENTRY_S_M - station) / speed_mps),
                time_gap_s=TIGHT_GAP_S,
            )
        )
    return tuple(cars)
