"""The fields of the vector inputs of both streams, in order, and where the route checkpoints begin in the raw one."""

from __future__ import annotations

CHECKPOINTS_AHEAD = 3
CHECKPOINT_SCALE_M = 25.0
MOTION_FIELDS = ('speed_mps', 'yaw_rate_radps', 'specific_force_x_mps2', 'specific_force_y_mps2')
# Raw stream: motion, then the next checkpoints in `base_link`, divided by CHECKPOINT_SCALE_M.
VECTOR_FIELDS = (*MOTION_FIELDS, *(f'checkpoint_{i}_{axis}' for i in range(CHECKPOINTS_AHEAD) for axis in ('x', 'y')))
VECTOR_SIZE = len(VECTOR_FIELDS)
FIRST_CHECKPOINT = len(MOTION_FIELDS)
# Privileged stream; both decoders reconstruct it.
EGO_FIELDS = ('speed_mps', 'steer', 'throttle', 'brake', 'yaw_rate_radps')
EGO_SIZE = len(EGO_FIELDS)
