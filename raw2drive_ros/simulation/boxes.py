"""Oriented boxes in the plane."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Float64


def corners_m(x: float, y: float, yaw: float, length: float, width: float) -> Float64:
    """(4, 2) corners of an oriented box, counter-clockwise from front left."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    ax, ay = cos * length / 2, sin * length / 2
    bx, by = -sin * width / 2, cos * width / 2
    return np.array(
        [
            (x + ax + bx, y + ay + by),
            (x - ax + bx, y - ay + by),
            (x - ax - bx, y - ay - by),
            (x + ax - bx, y + ay - by),
        ]
    )


def boxes_overlap(a: Float64, b: Float64) -> bool:
    """Whether two oriented boxes, (4, 2) corners in order, intersect (separating axis theorem)."""
    for box in (a, b):
        for edge in (box[1] - box[0], box[2] - box[1]):
            axis = np.array((-edge[1], edge[0]))
            pa, pb = a @ axis, b @ axis
            if pa.max() < pb.min() or pb.max() < pa.min():
                return False
    return True
