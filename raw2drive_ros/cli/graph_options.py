"""The options `--namespace` and `--network` of verbs that start nodes."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Sequence
from typing import Any

# Without importing the nodes' room: this module is loaded for `--help`.
NETWORK_VARIABLE = 'RAW2DRIVE_NETWORK'
# Of ROS: words of letters, digits and single underscores that do not begin with a digit.
NAMESPACE = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')


def namespace(text: str) -> str:
    """'' or a namespace with its leading slash. Raises ArgumentTypeError."""
    name = '/' + text.strip('/') if text.strip('/') else ''
    if name and (not NAMESPACE.fullmatch(name) or '__' in name):
        raise argparse.ArgumentTypeError(
            f'{text!r}: a namespace is as /car1: letters, digits and single underscores, no digit first'
        )
    return name


class _OpenNetwork(argparse.Action):
    """Sets the variable that this process and all nodes that it starts go by, see nodes/transport.py."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, default=False, **options)

    def __call__(
        self, parser: argparse.ArgumentParser, options: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        os.environ[NETWORK_VARIABLE] = '1'
        setattr(options, self.dest, True)


def add_network_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--network`."""
    parser.add_argument(
        '--network',
        action=_OpenNetwork,
        help=f'let other machines take part, as {NETWORK_VARIABLE}=1 does (default: nodes stay on this machine)',
    )


def add_namespace_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--namespace`."""
    parser.add_argument(
        '--namespace', type=namespace, default='', help='of nodes and topics, as /car1: several cars in one domain'
    )


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--namespace` and `--network`."""
    add_namespace_argument(parser)
    add_network_argument(parser)
