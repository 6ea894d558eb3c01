"""Linear maps in a recurrent loop whose weight gradients are computed once, after the loop.

Backpropagation through T steps of a small batch adds a weight-sized matrix T times; the time goes into memory traffic.
Here each step keeps its input and its output gradient, and the first step (whose backward pass comes last, because
all later steps depend on it) computes the weight gradient as one product of all of them. Exact up to rounding.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class DeferredLinear:
    """The linear map of one weight in one loop. Make a new one for every loop and call it once per step.

    Inputs: (N, I), or (blocks, N, I); all but the first must depend on the first output. weight: (I, O), or
    (blocks, I, O). bias: (O,), or (blocks, 1, O), or None. The backward pass raises RuntimeError if it reaches the
    first step before a later one.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None) -> None:
        self.weight, self.bias = weight, bias
        self.inputs: list[Tensor] = []
        self.gradients: list[Tensor] = []
        self.calls = 0

    def __call__(self, x: Tensor) -> Tensor:
        return _Step.apply(x, self.weight, self.bias, self)


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, loop: DeferredLinear) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.loop, ctx.first = loop, loop.calls == 0
        loop.calls += 1
        if bias is None:
            return x @ weight
        if weight.dim() == 3:
            return torch.baddbmm(bias, x, weight)
        return torch.addmm(bias, x, weight)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        x, weight = ctx.saved_tensors
        loop: DeferredLinear = ctx.loop
        loop.inputs.append(x)
        loop.gradients.append(gradient)
        back = gradient @ weight.transpose(-1, -2) if ctx.needs_input_grad[0] else None
        if not ctx.first:
            return back, None, None, None
        if len(loop.inputs) != loop.calls:
            raise RuntimeError(
                'DeferredLinear: the first step must feed all later ones, but its backward pass came first'
            )
        rows, gradients = torch.cat(loop.inputs, -2), torch.cat(loop.gradients, -2)
        loop.inputs.clear()
        loop.gradients.clear()
        bias = gradients.sum(-2, keepdim=gradients.dim() == 3) if ctx.needs_input_grad[2] else None
        return back, rows.transpose(-1, -2) @ gradients, bias, None
