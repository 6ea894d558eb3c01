"""The one table of BEV mask channels: 7 static ones, and 9 dynamic classes at 4 moments each = 43.

The paper gives the number 43 and the two groups, not the list; this is ours. Code, tests and
`docs/topics.md` all read it here.
"""

from __future__ import annotations

from raw2drive_ros.tables.rates import PHYSICS_HZ

STATIC_CHANNELS = (
    'road',
    'route',
    'ego',
    'route_lane',
    'centre_line',
    'lane_line',
    'crosswalk_or_stop_line',
)
DYNAMIC_CHANNELS = (
    'vehicle',
    'cyclist',
    'walker',
    'emergency_vehicle',
    'obstacle',
    'light_green',
    'light_yellow',
    'light_red',
    'stop_sign',
)
# Ages in physics ticks (0, 0.25, 0.5, 0.75 s); past boxes are drawn in the CURRENT ego frame.
HISTORY_TICKS = (0, 5, 10, 15)

CHANNELS = STATIC_CHANNELS + tuple(
    f'{name}@-{age / PHYSICS_HZ:.2f}s' if age else f'{name}@now' for name in DYNAMIC_CHANNELS for age in HISTORY_TICKS
)
CHANNEL_COUNT = len(CHANNELS)
SIZE_PX = 128
PIXELS_PER_M = 2.0
# The ego's centre: 30 % up from the bottom edge, in the middle column.
EGO_ROW_PX = SIZE_PX * 0.7
EGO_COLUMN_PX = SIZE_PX * 0.5


def dynamic_channel(name: str, moment: int) -> int:
    """Index of class `name` at `HISTORY_TICKS[moment]`."""
    return len(STATIC_CHANNELS) + DYNAMIC_CHANNELS.index(name) * len(HISTORY_TICKS) + moment
