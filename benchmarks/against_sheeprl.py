"""One training step (world model and behaviour) of this project and of sheeprl's DreamerV3 at equal sizes, in turns.

Each runs in its own process, one waits while the other works, so that a busy machine slows both; random data. While
other work runs use one thread: two wait for each other at every operation, and both sides become many times slower.

Equal: 16 sequences of 32 observations of 64x64x3 and a vector of 5, an embedding of 2048 + 64, a deterministic state
of 512, 32x32 latents in one flat vector, 256 hidden units, 39 actions, 512 imagined rollouts of 15 steps, 255 bins, 2
layers in actor and critic, 1 in the reward and continue heads, a slow critic, clipped gradients, fused Adam, float32,
threads, and what is timed: from a batch in memory to the updated weights, without sampling from a replay buffer.

Not equal, because that is how the two are built:
- Observations. Ours: 3 binary masks with a cross-entropy; patches of 8x8 as channels, 1x1 and depthwise 3x3
  convolutions on an 8x8 grid, no norms, as in the presets for two cores. sheeprl: images with a squared error; four 4x4
  convolutions of stride 2 with norms, widths 16 to 128. With --full-convolutions, each of ours looks at all 96
  features, which costs about as many operations as sheeprl's; the decoder's first layer has 1024 outputs here and
  2048 there.
- Recurrence. Ours: inputs embedded one by one, a GRU of 8 blocks, weight gradients computed once after the sequence.
  sheeprl: one embedding and a dense GRU with a learned first state. Its prior has one hidden layer, ours two.
- Behaviour. Ours: one loss, backward pass and optimiser for actor and critic; both act without recording gradients.
  sheeprl: one of each for either; its actor, reward and continue head also see one state more per rollout (16).
- Details. Ours: RMS norms, inverse-CDF sampling from uniforms, imagined samples as indices (sums of rows in place of
  products with one-hot vectors). sheeprl: layer norms, torch.distributions.
- Metrics. Ours are computed in every step; sheeprl's are switched off, which is in its favour. torch.compile, an
  option of sheeprl's, is off as by default.
The tables of parameters and operations show how much of a ratio is less work and how much is faster work.
Speed at these sizes says nothing about how well either learns.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault('THP_MEM_ALLOC_ENABLE', '1')

import torch

from benchmarks.sheeprl_steps import gflop, parameter_count, timed
from benchmarks.training_step import random_batch
from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.training.config import RunConfig
from raw2drive_ros.training.privileged import PrivilegedTrainer

EXAMPLES = """examples:
  python -m benchmarks.against_sheeprl --sheeprl-python /path/to/venv/bin/python
  python -m benchmarks.against_sheeprl --sheeprl-python /path/to/venv/bin/python --threads 1 --rounds 10 --json
"""
INSTALL = """make an environment for it (it is no dependency of this project):
  python3 -m venv sheeprl_venv
  echo torch==2.13.0 > sheeprl_constraints.txt
  sheeprl_venv/bin/pip install -c sheeprl_constraints.txt torch sheeprl==0.8.4
The pin is this project's version of torch; pip then takes a CPU build where one is offered. Afterwards,
give --sheeprl-python sheeprl_venv/bin/python"""
SMALLEST_IMAGE, LAST_WIDTH = 4, 8


def our_config(*, full_convolutions: bool = False) -> RunConfig:
    """The configuration that sets the sizes of both; `their_sizes` derives sheeprl's."""
    model = {
        'mask_classes': {'road': ['road'], 'route': ['route'], 'vehicle': ['vehicle@now']},
        'latent': 'flat',
        'stoch': 32,
        'classes': 32,
        'encoder_width': 96,
        'depthwise': not full_convolutions,
    }
    train = {'batch': 16, 'length': 32, 'starts': 512, 'horizon': 15}
    return RunConfig.model_validate({'preset': 'against_sheeprl', 'model': model, 'train': train})


def their_sizes(config: RunConfig, threads: int) -> dict[str, Any]:
    """The sizes that `sheeprl_steps` takes, see there."""
    m, t = config.model, config.train
    sizes: dict[str, Any] = {
        name: getattr(m, name)
        for name in ('deter', 'hidden', 'units', 'stoch', 'classes', 'bins', 'unimix', 'vector_features')
    }
    # Its convolutions end in LAST_WIDTH * conv_width features on a grid of 4 x 4.
    conv_width = m.grid_features * m.grid**2 // (LAST_WIDTH * SMALLEST_IMAGE**2)
    sizes |= {'batch': t.batch, 'length': t.length, 'horizon': t.horizon, 'threads': threads}
    sizes |= {'side': m.mask_size, 'channels': len(m.mask_classes), 'conv_width': conv_width, 'layers': m.head_layers}
    return sizes | {'actions': ACTION_COUNT, 'ego': m.ego_size}


def our_parameters(trainer: PrivilegedTrainer) -> dict[str, int]:
    """Counts by part, named as in `sheeprl_steps`."""
    model, critic = trainer.model, trainer.policy.critic
    parts: dict[str, list[Any]] = {
        'encoder': [model.encoder, model.vector_encoder],
        'recurrence': [],
        'prior': [],
        'posterior': [],
        'decoder': [model.decoder],
        'reward': [model.reward],
        'continue': [model.cont],
        'actor': [trainer.policy.actor],
        'critic': [critic.fast],
        'slow critic': [critic.slow],
    }
    kinds = {'input': 'recurrence', 'core': 'recurrence', 'prior': 'prior', 'post': 'posterior'}
    for name, module in model.rssm.named_children():
        parts[kinds[name.split('_')[0]]].append(module)
    return {name: parameter_count(found) for name, found in parts.items()}


class Sheeprl:
    """The process that takes sheeprl's steps."""

    def __init__(self, python: str, sizes: dict[str, Any]) -> None:
        script = Path(__file__).with_name('sheeprl_steps.py')
        # Isolated: the modules beside the script must not shadow those of sheeprl's dependencies.
        command = [python, '-I', '-W', 'ignore', str(script), json.dumps(sizes)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self.described = self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f'the process of sheeprl ended with code {self.process.wait()}; its errors stand above')
        answer: dict[str, Any] = json.loads(line)
        return answer

    def step(self) -> dict[str, Any]:
        assert self.process.stdin is not None
        # If the process has died, `_answer` reports it.
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write('step\n')
        return self._answer()

    def close(self) -> None:
        self.process.terminate()
        self.process.wait()


def require_sheeprl(python: str) -> None:
    """Ends the program, with advice, unless `python` can import sheeprl."""
    try:
        found = subprocess.run([python, '-I', '-c', 'import sheeprl'], capture_output=True, text=True, check=False)
    except OSError as error:
        raise SystemExit(f'cannot run {python}: {error.strerror}\n{INSTALL}') from error
    if found.returncode:
        reason = (found.stderr.strip().splitlines() or ['no message'])[-1]
        raise SystemExit(f'{python} cannot import sheeprl ({reason})\n{INSTALL}')


def summary(samples: list[dict[str, float]]) -> dict[str, float]:
    """Least and median times in milliseconds, and the peak memory."""
    found: dict[str, float] = {}
    for kind in ('wall', 'cpu'):
        times = [sample[f'{kind}_s'] * 1e3 for sample in samples]
        found |= {f'{kind}_least_ms': min(times), f'{kind}_median_ms': statistics.median(times)}
    return found | {'rss_mb': max(sample['rss_mb'] for sample in samples)}


def measure(python: str, threads: int, rounds: int, *, full_convolutions: bool = False) -> dict[str, Any]:
    """Steps of both sides in turns: times, memory, operations and parameters of each, and their ratios."""
    torch.set_num_threads(threads)
    config = our_config(full_convolutions=full_convolutions)
    trainer = PrivilegedTrainer(config)
    batch = random_batch(trainer)
    ours: dict[str, Any] = {'parameters': our_parameters(trainer), 'gflop': gflop(lambda: trainer.step(batch))}
    sheeprl = Sheeprl(python, their_sizes(config, threads))
    try:
        theirs = sheeprl.described
        our_samples, their_samples = [], []
        for _ in range(rounds + 1):
            our_samples.append(timed(lambda: trainer.step(batch)))
            their_samples.append(sheeprl.step())
    finally:
        sheeprl.close()
    # The first round warms both up.
    ours |= summary(our_samples[1:])
    theirs |= summary(their_samples[1:])
    ratios = {name: theirs[name] / ours[name] for name in ours if name != 'parameters'}
    versions = theirs.pop('versions') | {'our torch': str(torch.__version__)}
    shared = {'full_convolutions': full_convolutions, 'threads': threads, 'rounds': rounds, 'versions': versions}
    return shared | {'ours': ours, 'sheeprl': theirs, 'ratio': ratios}


def print_tables(result: dict[str, Any]) -> None:
    """The result of `measure` as Markdown."""
    ours, theirs, ratios = result['ours'], result['sheeprl'], result['ratio']
    versions = ', '.join(f'{name} {number}' for name, number in result['versions'].items())
    print(f'{versions}; torch threads: {result["threads"]}; rounds, in turns: {result["rounds"]}\n')
    print('| one training step | ours | sheeprl | sheeprl / ours |\n|---|---|---|---|')
    rows = {
        'wall, least ms': 'wall_least_ms',
        'wall, median ms': 'wall_median_ms',
        'CPU, least ms': 'cpu_least_ms',
        'CPU, median ms': 'cpu_median_ms',
        'products and convolutions, GFLOP': 'gflop',
        'peak memory, MB': 'rss_mb',
    }
    for title, name in rows.items():
        print(f'| {title} | {ours[name]:.0f} | {theirs[name]:.0f} | {ratios[name]:.2f} |')
    print('\n| parameters | ours | sheeprl |\n|---|---|---|')
    for name, count in ours['parameters'].items():
        print(f'| {name} | {count:,} | {theirs["parameters"][name]:,} |')
    print(f'| sum | {sum(ours["parameters"].values()):,} | {sum(theirs["parameters"].values()):,} |')


def main() -> None:
    """Measure both sides; print tables or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--sheeprl-python', required=True, metavar='PATH', help='python of an environment with sheeprl')
    parser.add_argument('--threads', type=int, default=2, help='of torch, in either process')
    parser.add_argument('--rounds', type=int, default=5, help='measured steps of each, after one to warm up')
    parser.add_argument('--full-convolutions', action='store_true', help='as many operations in 3x3 layers as sheeprl')
    parser.add_argument('--json', action='store_true', help='print JSON instead of tables')
    options = parser.parse_args()
    if options.threads < 1 or options.rounds < 1:
        parser.error('--threads and --rounds must be at least 1')
    require_sheeprl(options.sheeprl_python)
    convolutions = options.full_convolutions
    result = measure(options.sheeprl_python, options.threads, options.rounds, full_convolutions=convolutions)
    if options.json:
        json.dump(result, sys.stdout, indent=2)
        print()
    else:
        print_tables(result)


if __name__ == '__main__':
    main()
