"""Traffic flows, given by arrival times at a point: dense platoons without usable gaps, and gaps between them."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.scenario import TrafficSpec

# Arc length at which a vehicle enters its path.
ENTRY_S_M = 1.0
# In dense traffic IDM settles below its target speed; this factor keeps a flow near the speed it was drawn with.
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
    """Arrival times (s): a platoon from `first_s` to `until_s`, then `groups - 1` more, each `later_s` long, with gaps
    of `gap_s` between them."""
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
    """Vehicles that reach arc length `place_s_m` of their path at `times_s`; those that are not on it yet enter later.

    clear_m: no vehicle starts between these arc lengths, where the ego starts.
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
