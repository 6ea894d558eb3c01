"""The option `--domain`, whose default is ROS_DOMAIN_ID for every verb, as for every other ROS 2 program."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

VARIABLE = 'ROS_DOMAIN_ID'
# Above, Fast DDS takes ports that Linux gives to other programs.
DOMAINS = range(102)


class FromEnvironment(str):
    """The value of ROS_DOMAIN_ID: the parser turns it into a number as it does with a value of the command line."""

    __slots__ = ()


def domain_id(text: str) -> int:
    """A domain as a number. Raises ArgumentTypeError, which names ROS_DOMAIN_ID where the value comes from there."""
    if text.isascii() and text.isdigit() and len(text) < 4 and int(text) in DOMAINS:
        return int(text)
    place = f'{VARIABLE}={text}' if isinstance(text, FromEnvironment) else repr(text)
    raise argparse.ArgumentTypeError(f'{place}: a ROS domain is a whole number from 0 to {DOMAINS[-1]}')


def add_domain_argument(parser: argparse.ArgumentParser, *, free: bool = False) -> None:
    """Add `--domain`. Without it and without ROS_DOMAIN_ID: 0, or with `free` None, for the first free domain."""
    otherwise = 'the first free one from 50 on' if free else '0'
    value = os.environ.get(VARIABLE, '')
    default = FromEnvironment(value) if value else None if free else 0
    parser.add_argument(
        '--domain', type=domain_id, default=default, help=f'ROS domain (default: {VARIABLE}, or else {otherwise})'
    )


def heard_nobody(bags: Path) -> bool:
    """Whether a recorder's bag, or its folder of bags, holds only what the recorder says of itself."""
    from raw2drive_ros.contracts import topics
    from raw2drive_ros.contracts.errors import BagError
    from raw2drive_ros.recording.bag_reader import find_bags, open_bag

    try:
        for path in find_bags([bags]):
            with open_bag(path) as reader:
                if any(c.topic != topics.DIAGNOSTICS and c.msgcount for c in reader.connections):
                    return False
    except BagError:
        # No bag, or a damaged one, has its own message.
        return False
    return True


def nothing_there(domain: int) -> str:
    """What a verb says that listened and heard nobody."""
    return f'listened in ROS domain {domain}; nothing there: is the graph in another one (--domain, {VARIABLE})?'
