"""Linear maps in a recurrent loop whose weight gradients are computed once, after the loop.

Backpropagation through T steps of a thin batch adds a whole weight-sized matrix T times, which is memory traffic and
nothing else. Here each step keeps its input and its output gradient, and the first step (whose backward comes last,
because everything after it depends on it) multiplies them all at once. Exact up to rounding.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class DeferredLinear:
    """One weight during one loop: call it once per step, with inputs that depend on the step before.

    weight: (I, O), or (blocks, I, O) for inputs (blocks, N, I). bias: (O,), or (blocks, 1, O), or None. Make a new one
    for every loop.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None) -> None:
        self.weight, self.bias = weight, bias
        self.inputs: list[Tensor] = []
        self.gradients: list[Tensor] = []
        self.calls = 0

    def __call__(self, x: Tensor) -> Tensor:
        first = self.calls == 0
        self.calls += 1
        return _Step.apply(x, self.weight, self.bias, self, first)


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, loop: DeferredLinear, first: bool) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.loop, ctx.first = loop, first
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
            return back, None, None, None, None
        if len(loop.inputs) != loop.calls:
            raise RuntimeError('DeferredLinear: the first step must feed all later ones; it came back before some did')
        rows, gradients = torch.cat(loop.inputs, -2), torch.cat(loop.gradients, -2)
        loop.inputs.clear()
        loop.gradients.clear()
        bias = gradients.sum(-2, keepdim=gradients.dim() == 3) if ctx.needs_input_grad[2] else None
        return back, rows.transpose(-1, -2) @ gradients, bias, None, None
