"""The reward's terms over two drives of one route: does the better drive earn more?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.rates import DECISION_HZ

# DreamerV3's horizon of 333 steps.
DISCOUNT = 1.0 - 1.0 / 333.0


@dataclass(frozen=True, slots=True)
class RewardTrace:
    """terms: name -> (T,) weighted values; their sum is the reward of each step."""

    result: RouteResult
    terms: dict[str, Float64]

    @property
    def rewards(self) -> Float64:
        return np.sum(list(self.terms.values()), axis=0)

    @property
    def discounted_return(self) -> float:
        """Seen from the first step; after the end of the drive, rewards count as zero."""
        return float(self.rewards @ DISCOUNT ** np.arange(len(self.rewards)))


def trace(route: RouteId, driver: EpisodeDriver) -> RewardTrace:
    """A drive under the rules of training: it ends at the first collision, red light or stop sign."""
    env = DrivingEnv(SimulationConfig(cameras=driver.needs_cameras, bev=driver.needs_bev, end_on_infraction=True))
    drive = drive_route(env, driver, route)
    return RewardTrace(drive.result, {name: np.array([t[name] for t in drive.terms]) for name in drive.terms[0]})


def save_reward_plot(target: Path, route: RouteId, traces: dict[str, RewardTrace]) -> Path:
    """A PNG: per driver the terms over time, below them the running sums. Raises OSError."""
    # Imported late: it takes half a second.
    from matplotlib.figure import Figure

    figure = Figure((11, 2.6 * (len(traces) + 1)), layout='constrained')
    axes = figure.subplots(len(traces) + 1, 1, sharex=True)
    for axis, (name, drive) in zip(axes, traces.items(), strict=False):
        seconds = np.arange(len(drive.rewards)) / DECISION_HZ
        for term, values in drive.terms.items():
            if values.any():
                axis.plot(seconds, values, label=term, linewidth=1.2)
        events = ', '.join(drive.result.infractions) or 'success'
        axis.set_title(
            f'{name}: {events}, return {drive.discounted_return:.0f} (discounted), {drive.rewards.sum():.0f}'
        )
        axis.set_ylabel('reward per step')
        axis.legend(loc='lower right', ncols=6, fontsize=8)
        axis.grid(alpha=0.3)
        axes[-1].plot(seconds, np.cumsum(drive.rewards), label=name)
    axes[-1].set(xlabel='seconds', ylabel='sum of rewards')
    axes[-1].legend()
    axes[-1].grid(alpha=0.3)
    figure.suptitle(str(route))
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=110)
    return target
