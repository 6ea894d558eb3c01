"""What breaks a sequence of ticks: the one rule for driver, bag reader, training, replay and doctor."""

from __future__ import annotations

from raw2drive_ros.tables.rates import DECISION_NS

# Half a period is room for the jitter of a real camera; two periods mean that a tick is missing.
GAP_PERIODS = 1.5
LARGEST_STEP_NS = round(GAP_PERIODS * DECISION_NS)
# Stamps this far behind those before belong to another time: a simulation reset, a bag in a loop, a clock set back. A
# tick that is sent again is never that old. The planner takes as much for a jump of time.
BACK_NS = 500_000_000


def follows(before_ns: int | None, stamp_ns: int, *, same_drive: bool = True, complete: bool = True) -> bool:
    """Whether the tick at `stamp_ns` is the next step of the sequence whose last tick was at `before_ns`.

    It is not, and the recurrent state, the last action and everything else that is carried from step to step begin
    anew, where

    - there is no tick before it (None),
    - more than `GAP_PERIODS` decision periods lie between the two,
    - time went back (a tick at the same stamp is the same tick again),
    - another drive began (`same_drive`): another episode, or another route, which is what a car knows of it,
    - a tick between them was dropped or is incomplete, for example because a message of it was refused (`complete`).

    A latent model predicts one decision period ahead, with the action of that period. Over a gap it would be given one
    action for several, and a state from before them; training would learn that as one step. So both start again:
    training marks such a tick as a first one, and the driver, which is trained to start anywhere in a drive, forgets at
    every lost tick what it has seen before. That costs what no longer shows: an actor behind another one, the age of a
    red light. A planner whose camera sets come at less than 1 / `GAP_PERIODS` of the rate is stopped by the monitor
    before it drives without memory (`stop_gap_s`).
    """
    if before_ns is None or not same_drive or not complete:
        return False
    return 0 <= stamp_ns - before_ns <= LARGEST_STEP_NS
