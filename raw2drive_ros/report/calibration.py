"""What a privileged world model and its critic predict on bags, against what was recorded there.

Every state is a filtered one (posterior). An episode of T ticks, as in `training.replay`:

    state    s0      s1      ...  s(T-1)
    action           a1      ...            a_t LED to s_t
    reward           r1      ...  r(T-1)    of arriving at s_t
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.training.dataset import FIRST, LAST, TERMINAL, BagArrays
from raw2drive_ros.world_model.agent import imagine_open_loop
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.teacher import Teacher

HORIZONS = (1, 5, 10)
# Edges of the bins of predicted probability. Most states are far from an end, so the first tenth is split further.
EDGES = np.array([0.0, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
DECILES = 10
# terminal: a failure, nothing follows. last: the environment stopped (route driven, time out). cut: the
# recording stopped.
ENDS = ('terminal', 'last', 'cut')
# Ticks that are filtered, and states that are imagined from, at a time: the masks of a whole bag would fill the memory.
CHUNK = 64
# Row -1 is zero, for a tick that no action led to.
ONE_HOT = torch.cat([torch.eye(ACTION_COUNT), torch.zeros(1, ACTION_COUNT)])
Bools = NDArray[np.bool_]


@dataclass(slots=True)
class Traces:
    """N states of one episode, or of several, concatenated.

    ending, ended, known: (N, 3), by `HORIZONS`: the predicted probability of a terminal step within that many steps,
    whether there was one, and whether the recording can tell. reward, recorded, value, returned: (N,), see
    `realised_returns`; reward_known, value_known: (N,), where they are compared. end: (N,), index into `ENDS`."""

    ending: Float64
    ended: Bools
    known: Bools
    reward: Float64
    recorded: Float64
    reward_known: Bools
    value: Float64
    returned: Float64
    value_known: Bools
    end: NDArray[np.int64]


def horizon_steps(gamma: float) -> int:
    """1 / (1 - gamma): rewards further ahead than this have a weight below 1/e."""
    return round(1.0 / (1.0 - gamma))


def realised_returns(reward: Float64, gamma: float, after: float) -> Float64:
    """(T,) rewards -> (T,) discounted return of what came AFTER each tick: G_t = r_(t+1) + gamma G_(t+1), and
    `after` for the last tick."""
    found = np.full(len(reward), float(after))
    for t in reversed(range(len(reward) - 1)):
        found[t] = reward[t + 1] + gamma * found[t + 1]
    return found


def ended_within(ticks: int, steps: int, *, terminal: bool) -> tuple[Bools, Bools]:
    """(ended, known), both (ticks,): does an episode whose last tick is terminal (or not) end within `steps` of each
    tick? Not known at its last tick, nor where it stopped sooner than that without a terminal step."""
    left = np.arange(ticks)[::-1]
    return terminal & (left <= steps), (left > 0) & (terminal | (left >= steps))


def episodes_of(flags: NDArray[np.uint8]) -> list[slice]:
    """The slice of each episode of a bag; the first episode may have begun before the recording did."""
    starts = sorted({0, *map(int, np.flatnonzero(flags & FIRST))})
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(flags)], strict=True)]


class CalibrationProbe:
    """Filters and imagines with generators of its own; the same bags in the same order give the same numbers.

    samples: imagined futures of each state, whose mean is the predicted probability."""

    def __init__(self, teacher: Teacher, samples: int = 4, seed: int = 0) -> None:
        self.model, self.critic = teacher.model.eval(), teacher.policy.critic.eval()
        self.codec, self.gamma = MaskCodec(teacher.config), teacher.gamma
        self.samples = samples
        # Two generators, so that filtering does not depend on how much is imagined.
        self.filtering, self.imagining = (torch.Generator().manual_seed(2 * seed + i) for i in (0, 1))

    def traces(self, bag: BagArrays, progress: Callable[[int], None] = lambda ticks: None) -> Iterator[Traces]:
        """Episode by episode; progress: ticks of the bag that are done."""
        for where in episodes_of(bag.flags):
            yield self._episode(bag, where, progress)

    @torch.no_grad()
    def _episode(self, bag: BagArrays, where: slice, progress: Callable[[int], None]) -> Traces:
        flags, recorded = bag.flags[where], bag.reward[where].astype(float)
        ticks, last = len(flags), int(flags[-1])
        actions = ONE_HOT[torch.from_numpy(bag.action[where])]
        state: State | None = None
        rewards, values, endings = [], [], []
        for begin in range(0, ticks, CHUNK):
            part = slice(begin, min(begin + CHUNK, ticks))
            inside = slice(where.start + part.start, where.start + part.stop)
            states = self._filter(bag, inside, actions[part], flags[part], state)
            rewards.append(self.model.reward(states.feature))
            values.append(self.critic(states.feature))
            # Beyond the end of the recording the last action is repeated, because no other is recorded.
            ahead = (torch.arange(part.start, part.stop)[:, None] + 1 + torch.arange(max(HORIZONS))).clamp(
                max=ticks - 1
            )
            endings.append(self._imagine(states, actions[ahead]))
            state = State(states.deter[-1:], states.stoch[-1:])
            progress(inside.stop)
        terminal = bool(last & TERMINAL)
        ended, known = zip(*(ended_within(ticks, k, terminal=terminal) for k in HORIZONS), strict=True)
        value = torch.cat(values).double().numpy()
        left = np.arange(ticks)[::-1]
        return Traces(
            torch.cat(endings).double().numpy(),
            np.stack(ended, 1),
            np.stack(known, 1),
            torch.cat(rewards).double().numpy(),
            recorded,
            (flags & FIRST) == 0,
            value,
            realised_returns(recorded, self.gamma, 0.0 if terminal else value[-1]),
            left > 0 if terminal else left >= horizon_steps(self.gamma),
            np.full(ticks, 0 if terminal else 1 if last & LAST else 2),
        )

    def _filter(
        self, bag: BagArrays, where: slice, actions: Tensor, flags: NDArray[np.uint8], start: State | None
    ) -> State:
        """(T, ...) sampled posterior states of the ticks that follow the state `start`."""
        masks = torch.from_numpy(self.codec.unpack(bag.masks[where])).float()
        embed = self.model.embed(*self.model.encode(masks, torch.from_numpy(bag.ego[where])))
        uniform = torch.rand(len(masks), self.model.rssm.config.stoch, generator=self.filtering)
        first = torch.from_numpy((flags & FIRST) > 0)
        states, _ = self.model.rssm.observe(embed[None], actions[None], first[None], uniform[None], start)
        return State(states.deter[0], states.stoch[0])

    def _imagine(self, start: State, actions: Tensor) -> Tensor:
        """(N, 3) probability of having ended within `HORIZONS` steps on (N, K, A) actions."""
        rssm, steps = self.model.rssm, actions.shape[1]
        begin = State(*(x.repeat_interleave(self.samples, 0) for x in (start.deter, start.stoch)))
        uniforms = (torch.rand(len(begin.deter), rssm.config.stoch, generator=self.imagining) for _ in range(steps))
        going, found = torch.ones(len(begin.deter)), []
        for state in imagine_open_loop(rssm, begin, actions.repeat_interleave(self.samples, 0), uniforms):
            going = going * self.model.cont(state.feature)
            found.append(1.0 - going.view(-1, self.samples).mean(1))
        return torch.stack([found[k - 1] for k in HORIZONS], 1)


def reliability(predicted: Float64, happened: Bools) -> dict[str, Any]:
    """Of (N,) probabilities: brier, and brier_of_rate, the score of always predicting the observed rate; the non-empty
    bins of `EDGES`, each with the mean prediction and the share that happened. None where undefined."""
    place = np.clip(np.digitize(predicted, EDGES) - 1, 0, len(EDGES) - 2)
    bins = [
        {
            'low': float(EDGES[i]),
            'high': float(EDGES[i + 1]),
            'states': int((place == i).sum()),
            'predicted': float(predicted[place == i].mean()),
            'happened': float(happened[place == i].mean()),
        }
        for i in np.unique(place)
    ]
    rate = _mean(happened)
    return {
        'states': len(predicted),
        'happened': rate,
        'predicted': _mean(predicted),
        'brier': _mean((predicted - happened) ** 2),
        'brier_of_rate': None if rate is None else rate * (1.0 - rate),
        'bins': bins,
    }


def agreement(predicted: Float64, true: Float64) -> dict[str, Any]:
    """Of (N,) numbers: bias (mean of predicted - true), rmse, r2, correlation; None where undefined."""
    error = predicted - true
    varied = len(true) > 1 and np.ptp(true) > 0
    both = varied and np.ptp(predicted) > 0
    return {
        'states': len(true),
        'true': _mean(true),
        'predicted': _mean(predicted),
        'bias': _mean(error),
        'rmse': float(np.sqrt((error**2).mean())) if len(true) else None,
        'r2': float(1.0 - (error**2).mean() / true.var()) if varied else None,
        'correlation': float(np.corrcoef(predicted, true)[0, 1]) if both else None,
    }


def deciles(predicted: Float64, true: Float64) -> list[dict[str, Any]]:
    """Mean error by decile of the PREDICTION. By decile of the truth, even the best predictor would be too high at the
    low end and too low at the high one (regression to the mean)."""
    parts = [part for part in np.array_split(np.argsort(predicted, kind='stable'), DECILES) if len(part)]
    return [
        {
            'low': float(predicted[part[0]]),
            'high': float(predicted[part[-1]]),
            'states': len(part),
            'error': float((predicted[part] - true[part]).mean()),
        }
        for part in parts
    ]


def joined(traces: Sequence[Traces]) -> Traces:
    """All of them concatenated; at least one."""
    return Traces(*(np.concatenate([getattr(t, f.name) for t in traces]) for f in fields(Traces)))


def numbers(traces: Sequence[Traces], gamma: float) -> dict[str, Any]:
    """All statistics of these episodes by head, as a dictionary for JSON."""
    states = joined(traces)
    compared = {'all': states.value_known}
    compared |= {name: states.value_known & (states.end == i) for i, name in enumerate(ENDS)}
    reward = states.reward[states.reward_known], states.recorded[states.reward_known]
    return {
        'ticks': len(states.end),
        'episodes': {name: sum(int(t.end[0]) == i for t in traces) for i, name in enumerate(ENDS)},
        'gamma': gamma,
        'continue': {
            str(k): reliability(states.ending[known, i], states.ended[known, i]) | {'left_out': int((~known).sum())}
            for i, k in enumerate(HORIZONS)
            for known in [states.known[:, i]]
        },
        'reward': agreement(*reward) | {'deciles': deciles(*reward)},
        'value': {name: agreement(states.value[rows], states.returned[rows]) for name, rows in compared.items()},
    }


def _mean(values: Float64 | Bools) -> float | None:
    return float(values.mean()) if len(values) else None
