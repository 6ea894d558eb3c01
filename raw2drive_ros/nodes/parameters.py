"""Parameters with descriptions, and values of the default's type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

Check = Callable[[Any], object]


def declare(node: Node, table: dict[str, tuple[Any, str]], live: dict[str, Check] | None = None) -> dict[str, Any]:
    """name -> (default, description); returns the values in force.

    live: parameters that may be set while the node runs, each with a check that raises ValueError for a value that will
    not do. All others are read once: setting them later is refused with that reason, instead of being ignored.
    """
    values = {}
    for name, (default, description) in table.items():
        parameter = node.declare_parameter(name, default, ParameterDescriptor(description=description))
        values[name] = parameter.value
    checks = live or {}

    def refuse(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name not in table:
                continue
            if parameter.name not in checks:
                reason = f'{parameter.name} is read when the node starts; start it again with another value'
                return SetParametersResult(successful=False, reason=reason)
            try:
                checks[parameter.name](parameter.value)
            except (ValueError, KeyError) as error:
                return SetParametersResult(successful=False, reason=str(error.args[0]))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(refuse)
    return values


def wants_compressed(image_transport: str) -> bool:
    """Whether the parameter `image_transport` asks for compressed images. Raises ValueError for another word."""
    if image_transport not in ('raw', 'compressed'):
        raise ValueError(f'image_transport {image_transport!r}: use raw or compressed')
    return image_transport == 'compressed'
