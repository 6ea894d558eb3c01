"""Declares parameters with descriptions; values have the type of the default."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

Check = Callable[[Any], object]
# Parameters that rclpy declares for every node.
BUILT_IN = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


def declare(node: Node, table: dict[str, tuple[Any, str]], live: dict[str, Check] | None = None) -> dict[str, Any]:
    """Declare the parameters of `table`, name -> (default, description), and return their values.

    live: parameters that may be set while the node runs, each with a check that raises ValueError or KeyError for an
    unusable value; initial values are checked too. All others are read once: setting them later is refused with that
    reason instead of being ignored. Raises ValueError for an unusable initial value and for an unknown name: a misspelt
    one must not leave a default in force.
    """
    # rclpy has no public list of the overrides given at start.
    given = getattr(node, '_parameter_overrides', {})
    unknown = sorted(name for name in given if name not in table and not name.startswith(BUILT_IN))
    if unknown:
        raise ValueError(f'no such parameter: {", ".join(unknown)}; {node.get_name()} knows {", ".join(table)}')
    values = {}
    for name, (default, description) in table.items():
        parameter = node.declare_parameter(name, default, ParameterDescriptor(description=description))
        values[name] = parameter.value
    checks = live or {}
    for name, check in checks.items():
        try:
            check(values[name])
        except KeyError as error:
            raise ValueError(str(error.args[0])) from error

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


def wants_best_effort(sensor_reliability: str) -> bool:
    """Whether the parameter `sensor_reliability` asks for BEST_EFFORT. Raises ValueError for another value."""
    if sensor_reliability not in ('reliable', 'best_effort'):
        raise ValueError(f'sensor_reliability {sensor_reliability!r}: use reliable or best_effort')
    return sensor_reliability == 'best_effort'


def wants_compressed(image_transport: str) -> bool:
    """Whether the parameter `image_transport` asks for compressed images. Raises ValueError for another value."""
    if image_transport not in ('raw', 'compressed'):
        raise ValueError(f'image_transport {image_transport!r}: use raw or compressed')
    return image_transport == 'compressed'
