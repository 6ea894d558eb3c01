"""The fields of the vector inputs of both streams, in order, and where the route checkpoints begin in the raw one."""

from __future__ import annotations

CHECKPOINTS_AHEAD = 3
CHECKPOINT_SCALE_M = 25.0
MOTION_FIELDS = ('speed_mps', 'yaw_rate_radps', 'specific_force_x_mps2', 'specific_force_y_mps2')
# Raw stream: motion, then the next checkpoints in `base_link`, divided by CHECKPOINT_SCALE_M.
VECTOR_FIELDS = (*MOTION_FIELDS, *(f'checkpoint_{i}_{axis}' for i in range(CHECKPOINTS_AHEAD) for axis in ('x', 'y')))
VECTOR_SIZE = len(VECTOR_FIELDS)
FIRST_CHECKPOINT = len(MOTION_FIELDS)
# Privileged stream; both decoders reconstruct it. Old bags and bundles have the first five alone.
BASIC_EGO_FIELDS = ('speed_mps', 'steer', 'throttle', 'brake', 'yaw_rate_radps')
# Of the vehicle's centre from the route, left positive; of its heading from that of the route, counter-clockwise.
ROUTE_ERROR_FIELDS = ('lateral_offset_m', 'heading_error_rad')
EGO_FIELDS = (*BASIC_EGO_FIELDS, *ROUTE_ERROR_FIELDS)
EGO_SIZE = len(EGO_FIELDS)
# The lights and signs that govern the ego, as far as its cameras have shown them: `/privileged/signals`.
LIGHT_FIELDS = ('light_none', 'light_green', 'light_yellow', 'light_red')
SIGNAL_FIELDS = (
    *LIGHT_FIELDS,
    'light_distance_m',
    'stop_sign',
    'stop_sign_distance_m',
    'stop_sign_obeyed',
    'yield_sign',
    'yield_sign_distance_m',
    'speed_limit_mps',
)
SIGNAL_SIZE = len(SIGNAL_FIELDS)
# Distance of a light or sign that is not there or has not been seen; none is reported from farther away.
SIGNAL_RANGE_M = 100.0
# What a privileged model can read as its vector input (`ModelConfig.ego_fields`).
PRIVILEGED_FIELDS = (*EGO_FIELDS, *SIGNAL_FIELDS)
