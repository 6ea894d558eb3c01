"""Networks of a configuration of unknown origin are built only as far as the weights beside it can fill them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torch import nn
from torch.nn.modules.module import register_module_parameter_registration_hook

from raw2drive_ros.bounds import tensor_shapes

# A teacher bundle leaves out copies that its networks have: the slow critic.
SPARE = 2
SPARE_ELEMENTS = 1_000_000


@contextmanager
def parameter_budget(weights: Path, most_bytes: int) -> Iterator[None]:
    """While this is open, building networks with far more parameters than the safetensors file holds raises ValueError,
    before their memory is used. Raises OSError or ValueError for a file that is none, or has more than `most_bytes`."""
    left = SPARE_ELEMENTS + SPARE * sum(math.prod(shape) for shape in tensor_shapes(weights, most_bytes).values())

    def count(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        nonlocal left
        left -= parameter.numel() if parameter is not None else 0
        if left < 0:
            raise ValueError('the configuration describes a larger model than its weights can fill')

    handle = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        handle.remove()
