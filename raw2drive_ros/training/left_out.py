"""Which bags a training run does not use, although they were given."""

from __future__ import annotations

import sys
from pathlib import Path

from raw2drive_ros.contracts.texts import shown
from raw2drive_ros.recording.bag_reader import search_bags
from raw2drive_ros.training.dataset import BagArrays
from raw2drive_ros.training.parallel import Ranks


def say_left_out(roots: list[Path], bags: list[BagArrays], length: int, ranks: Ranks) -> None:
    """Print a line on stderr for each reason. length: ticks of a sequence, which a shorter bag cannot fill."""
    lines = search_bags(roots).left_out()
    short = [bag for bag in bags if len(bag) < length]
    if short:
        names = ', '.join(str(bag.path) for bag in short[:3]) + (' ...' if len(short) > 3 else '')
        ticks = sum(len(bag) for bag in short)
        lines.append(f'{len(short)} bags, {ticks} ticks, are shorter than a sequence of {length} and not used: {names}')
    for line in lines if ranks.leads else ():
        print(shown(line), file=sys.stderr)
