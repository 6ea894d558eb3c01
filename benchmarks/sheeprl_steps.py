"""The other half of `benchmarks.against_sheeprl`: training steps of sheeprl's DreamerV3, in a process of its own.

It runs under the python of an environment that has sheeprl, and imports nothing of this project. Its argument holds
the sizes as JSON. It writes one JSON line that describes the networks, then one line of times for every line it reads.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from typing import Any

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

Step = Callable[[], object]
# The argument `is_continuous` of sheeprl: actions are discrete here.
IS_CONTINUOUS = False


def timed(step: Step) -> dict[str, float]:
    """Wall and CPU seconds of one step, and the peak memory of the process so far."""
    wall, cpu = time.perf_counter(), time.process_time()
    step()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {'wall_s': wall, 'cpu_s': cpu, 'rss_mb': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def gflop(step: Step) -> float:
    """10^9 floating-point operations of the matrix products and convolutions of one step."""
    with FlopCounterMode(display=False) as counter:
        step()
    return counter.get_total_flops() / 1e9


def parameter_count(parts: Iterable[nn.Module | nn.Parameter]) -> int:
    """Number of scalars in all parameters of the parts."""
    tensors = [[part] if isinstance(part, nn.Parameter) else part.parameters() for part in parts]
    return sum(tensor.numel() for group in tensors for tensor in group)


def compose(sizes: dict[str, Any]) -> Any:
    """sheeprl's own configuration at the given sizes; everything that is not named here is from its recipe S."""
    import hydra
    from omegaconf import OmegaConf
    from sheeprl.utils.utils import dotdict

    world = {
        'stochastic_size': sizes['stoch'],
        'discrete_size': sizes['classes'],
        'recurrent_model.recurrent_state_size': sizes['deter'],
        'recurrent_model.dense_units': sizes['hidden'],
        'transition_model.hidden_size': sizes['hidden'],
        'representation_model.hidden_size': sizes['hidden'],
        'encoder.cnn_channels_multiplier': sizes['conv_width'],
        'encoder.mlp_layers': 1,
        'encoder.dense_units': sizes['vector_features'],
        'observation_model.mlp_layers': 1,
        'reward_model.mlp_layers': 1,
        'reward_model.bins': sizes['bins'],
        'discount_model.mlp_layers': 1,
    }
    algo = {
        'horizon': sizes['horizon'],
        'per_rank_batch_size': sizes['batch'],
        'per_rank_sequence_length': sizes['length'],
        'dense_units': sizes['units'],
        'mlp_layers': sizes['layers'],
        'unimix': sizes['unimix'],
        'critic.bins': sizes['bins'],
        'mlp_keys.encoder': '[ego]',
    } | {f'world_model.{name}': value for name, value in world.items()}
    # Without its logging: work that does not update the weights is not counted against sheeprl.
    overrides = ['exp=dreamer_v3', 'env=dummy', f'env.screen_size={sizes["side"]}', 'metric.log_level=0']
    with hydra.initialize_config_module('sheeprl.configs', version_base='1.3'):
        config = hydra.compose('config', overrides + [f'algo.{name}={value}' for name, value in algo.items()])
    return dotdict(OmegaConf.to_container(config, resolve=True, throw_on_missing=False))


def random_data(sizes: dict[str, Any]) -> dict[str, torch.Tensor]:
    """A batch as sheeprl's sampler gives it: time first, 8-bit images as floats."""
    rows = (sizes['length'], sizes['batch'])
    action = torch.randint(0, sizes['actions'], rows)
    first = torch.zeros(*rows, 1)
    first[0] = 1.0
    side = sizes['side']
    return {
        'rgb': torch.randint(0, 256, (*rows, sizes['channels'], side, side), dtype=torch.uint8).float(),
        'ego': torch.rand(*rows, sizes['ego']),
        'actions': nn.functional.one_hot(action, sizes['actions']).float(),
        'rewards': torch.ones(*rows, 1),
        'terminated': torch.zeros(*rows, 1),
        'is_first': first,
    }


def build(sizes: dict[str, Any]) -> tuple[Step, dict[str, int]]:
    """A training step of sheeprl, as the loop of its `main` takes it, and its parameter counts by part."""
    import gymnasium
    import hydra
    import numpy as np
    from sheeprl.algos.dreamer_v3.agent import build_agent
    from sheeprl.algos.dreamer_v3.dreamer_v3 import train
    from sheeprl.algos.dreamer_v3.utils import Moments
    from sheeprl.utils.metric import MetricAggregator
    from sheeprl.utils.timer import timer

    config = compose(sizes)
    algo = config.algo
    timer.disabled = MetricAggregator.disabled = True
    torch.set_float32_matmul_precision(config.float32_matmul_precision)
    # sheeprl samples with it; its own configuration decides here.
    torch.distributions.Distribution.set_default_validate_args(config.distribution.validate_args)  # noqa: TID251
    fabric = hydra.utils.instantiate(config.fabric, _convert_='all')
    torch.manual_seed(config.seed)
    image = (sizes['channels'], sizes['side'], sizes['side'])
    space = gymnasium.spaces.Dict(
        rgb=gymnasium.spaces.Box(0, 255, image, np.uint8),
        ego=gymnasium.spaces.Box(-1.0, 1.0, (sizes['ego'],), np.float32),
    )
    actions = (sizes['actions'],)
    world, actor, critic, slow, _ = build_agent(fabric, actions, IS_CONTINUOUS, config, space)
    optimizers = fabric.setup_optimizers(
        *(
            hydra.utils.instantiate(part.optimizer, params=module.parameters(), _convert_='all')
            for part, module in ((algo.world_model, world), (algo.actor, actor), (algo.critic, critic))
        )
    )
    percentile = algo.actor.moments.percentile
    moments = Moments(algo.actor.moments.decay, algo.actor.moments.max, percentile.low, percentile.high)
    data = random_data(sizes)

    def step() -> None:
        with torch.no_grad():
            torch._foreach_lerp_(list(slow.parameters()), list(critic.parameters()), algo.critic.tau)
        train(fabric, world, actor, critic, slow, *optimizers, data, None, config, IS_CONTINUOUS, actions, moments)

    rssm = world.rssm
    parts = {
        'encoder': [world.encoder],
        'recurrence': [rssm.recurrent_model, rssm.initial_recurrent_state],
        'prior': [rssm.transition_model],
        'posterior': [rssm.representation_model],
        'decoder': [world.observation_model],
        'reward': [world.reward_model],
        'continue': [world.continue_model],
        'actor': [actor],
        'critic': [critic],
        'slow critic': [slow],
    }
    return step, {name: parameter_count(found) for name, found in parts.items()}


def main() -> None:
    """Describe the networks, then take a step for every line of standard input."""
    # Whatever the libraries print goes to standard error: standard output carries nothing but the protocol.
    answers = os.fdopen(os.dup(1), 'w', buffering=1)
    os.dup2(2, 1)
    sizes = json.loads(sys.argv[1])
    torch.set_num_threads(sizes['threads'])
    step, parameters = build(sizes)
    versions = {'sheeprl': version('sheeprl'), 'torch': str(torch.__version__)}
    print(json.dumps({'versions': versions, 'parameters': parameters, 'gflop': gflop(step)}), file=answers)
    for _ in sys.stdin:
        print(json.dumps(timed(step)), file=answers)


if __name__ == '__main__':
    main()
