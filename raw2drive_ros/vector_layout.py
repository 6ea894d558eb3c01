"""What the vector inputs of both streams hold, field by field, and where in the raw one the route checkpoints are."""

from __future__ import annotations

CHECKPOINTS_AHEAD = 3
CHECKPOINT_SCALE_M = 25.0
MOTION_FIELDS = ('speed_mps', 'yaw_rate_radps', 'specific_force_x_mps2', 'specific_force_y_mps2')
# Of the raw stream: motion, then the next checkpoints in `base_link` / CHECKPOINT_SCALE_M.
VECTOR_FIELDS = (*MOTION_FIELDS, *(f'checkpoint_{i}_{axis}' for i in range(CHECKPOINTS_AHEAD) for axis in ('x', 'y')))
VECTOR_SIZE = len(VECTOR_FIELDS)
FIRST_CHECKPOINT = len(MOTION_FIELDS)
# Of the privileged stream, and what both decoders reconstruct.
EGO_FIELDS = ('speed_mps', 'steer', 'throttle', 'brake', 'yaw_rate_radps')
EGO_SIZE = len(EGO_FIELDS)
