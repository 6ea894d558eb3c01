"""Parameters with descriptions, and values of the default's type."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node


def declare(node: Node, table: dict[str, tuple[Any, str]]) -> dict[str, Any]:
    """name -> (default, description); returns the values in force."""
    values = {}
    for name, (default, description) in table.items():
        parameter = node.declare_parameter(name, default, ParameterDescriptor(description=description))
        values[name] = parameter.value
    return values


def wants_compressed(image_transport: str) -> bool:
    """Whether the parameter `image_transport` asks for compressed images. Raises ValueError for another word."""
    if image_transport not in ('raw', 'compressed'):
        raise ValueError(f'image_transport {image_transport!r}: use raw or compressed')
    return image_transport == 'compressed'
