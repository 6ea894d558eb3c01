"""AdamW: linear warm-up, a constant rate, linear decay, clipping; refuses to step on a gradient that is not finite."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from raw2drive_ros.contracts.errors import NonFiniteError
from raw2drive_ros.training.parallel import ALONE, Ranks


def decay_factor(step: int, total: int, share: float, end: float) -> float:
    """1 until the last `share` of `total` steps, from there linearly down to `end`.

    With a constant rate and a short decay at the end, a run can be continued with more steps; with a cosine over the
    whole run it cannot.
    """
    length = share * total
    if length <= 0:
        return 1.0
    return 1.0 - (1.0 - end) * min(1.0, max(0.0, (step - (total - length)) / length))


class Optimiser:
    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        lr: float,
        weight_decay: float,
        clip: float,
        warmup: int,
        ranks: Ranks = ALONE,
    ) -> None:
        self.parameters = [p for p in parameters if p.requires_grad]
        self.adam = torch.optim.AdamW(self.parameters, lr, eps=1e-8, weight_decay=weight_decay, fused=True)
        self.lr, self.clip, self.warmup, self.ranks = lr, clip, warmup, ranks
        self.steps = 0

    def step(self, loss: Tensor, factor: float = 1.0) -> float:
        """Backward, mean over the processes, clip, update; returns the gradient norm.

        factor: multiplies the learning rate, see `decay_factor`. Raises NonFiniteError, before any weight changes.
        """
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        self.ranks.mean_([p.grad for p in self.parameters if p.grad is not None])
        norm = float(nn.utils.clip_grad_norm_(self.parameters, self.clip))
        if not norm < float('inf'):
            raise NonFiniteError(f'gradient norm {norm} at step {self.steps}, loss {float(loss.detach())}')
        self.steps += 1
        rate = self.lr * factor * min(1.0, self.steps / max(1, self.warmup))
        for group in self.adam.param_groups:
            group['lr'] = rate
        self.adam.step()
        return norm

    def tensors(self) -> dict[str, Tensor]:
        """Number of steps and moments by parameter index, for a checkpoint."""
        found = {'steps': torch.tensor(self.steps)}
        for i, parameter in enumerate(self.parameters):
            for name, value in self.adam.state.get(parameter, {}).items():
                found[f'{i}.{name}'] = value
        return found

    def load_tensors(self, stored: dict[str, Tensor]) -> None:
        self.steps = int(stored['steps'])
        for key, value in stored.items():
            if key != 'steps':
                index, name = key.split('.', 1)
                self.adam.state[self.parameters[int(index)]][name] = value.clone()
