"""Classes of the rows of `/privileged/actors`. Their numbers are in bags: new ones are added at the end."""

from __future__ import annotations

from raw2drive_ros.tables.bev_channels import DYNAMIC_CHANNELS

# The classes of the dynamic BEV masks, and what those lack.
ACTOR_CLASSES = (*DYNAMIC_CHANNELS, 'yield_sign')
LIGHT_CLASSES = ('light_green', 'light_yellow', 'light_red')
SIGN_CLASSES = ('stop_sign', 'yield_sign')
# Farther actors, lights and signs are left out: cameras draw things up to 80 m away.
ACTOR_RANGE_M = 100.0
