"""Improves a linear policy on the vector observation by evolution strategies, in a minute.

It begins as a driver who steers at a point ahead and is slow; the return on new routes says what became of it.

python examples/gym/evolve.py [--rounds 20]
"""

import argparse

import gymnasium
import numpy as np

import raw2drive_ros.gym  # noqa: F401  registers Raw2Drive-v3
from raw2drive_ros.gym.observations import VECTOR_NAMES

# What the policy looks at.
NAMES = ('speed_mps', 'limit', 'lateral_offset_m', 'heading_error_rad', 'route_5m_y', 'route_10m_y', 'route_20m_y')
FEATURES = [VECTOR_NAMES.index(name) for name in NAMES]
START = {'pedal': {'limit': 1.0, 'speed_mps': -1.5}, 'steer': {'route_10m_y': 4.0}}
PAIRS, TICKS, NOISE, RATE = 4, 150, 0.3, 0.15


def start():
    """(2, F) weights of pedal and steering to begin with."""
    return np.array([[START[action].get(name, 0.0) for name in NAMES] for action in ('pedal', 'steer')])


def returns(envs, policies, seeds):
    """(N,) undiscounted returns of N policies, (N, 2, F), one per environment, each on the route of its seed."""
    seen, _ = envs.reset(seed=seeds)
    total, alive = np.zeros(len(policies)), np.ones(len(policies), bool)
    for _ in range(TICKS):
        actions = np.tanh(np.einsum('naf,nf->na', policies, seen[:, FEATURES]))
        seen, rewards, terminated, truncated, _ = envs.step(actions.astype(np.float32))
        total += np.where(alive, rewards, 0.0)
        alive &= ~(terminated | truncated)
    return total


def main() -> None:
    """Print the mean return on routes that it has not learned from, before and after."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--rounds', type=int, default=20)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    arguments = {'routes': 'lane-following', 'observation': 'vector', 'action': 'continuous'}
    envs = gymnasium.make_vec('Raw2Drive-v3', 2 * PAIRS, **arguments)
    mean = start()
    new = list(range(10_000, 10_000 + 2 * PAIRS))
    before = returns(envs, np.array([mean] * 2 * PAIRS), new).mean()
    for number in range(options.rounds):
        noise = rng.normal(size=(PAIRS, *mean.shape))
        # Each policy and its mirror image drive the same route.
        seeds = [PAIRS * number + i for i in range(PAIRS)] * 2
        found = returns(envs, mean + NOISE * np.concatenate([noise, -noise]), seeds)
        better = (found[:PAIRS] - found[PAIRS:]) / (found.std() + 1e-6)
        mean += RATE * np.einsum('p,paf->af', better, noise) / PAIRS
        print(f'round {number + 1}: mean return {found.mean():.1f}, best {found.max():.1f}')
    after = returns(envs, np.array([mean] * 2 * PAIRS), new).mean()
    print(f'mean return on new routes: {before:.1f} before, {after:.1f} after')
    envs.close()


if __name__ == '__main__':
    main()
