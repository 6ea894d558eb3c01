"""What the raw stream's vector input holds, and where in it the route checkpoints are."""

from __future__ import annotations

CHECKPOINTS_AHEAD = 3
CHECKPOINT_SCALE_M = 25.0
MOTION_FIELDS = ('speed_mps', 'yaw_rate_radps', 'specific_force_x_mps2', 'specific_force_y_mps2')
VECTOR_FIELDS = (*MOTION_FIELDS, *(f'checkpoint_{i}_{axis}' for i in range(CHECKPOINTS_AHEAD) for axis in ('x', 'y')))
VECTOR_SIZE = len(VECTOR_FIELDS)
FIRST_CHECKPOINT = len(MOTION_FIELDS)
