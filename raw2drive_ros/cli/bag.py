"""raw2drive bag info: what a bag holds."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

EXAMPLES = """examples:
  raw2drive bag info runs/demo/bag
  raw2drive bag info runs/demo/bag --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('info',))
    parser.add_argument('bag', type=Path)
    parser.add_argument('--json', action='store_true')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.bag_info import bag_info

    info = bag_info(options.bag)
    if options.json:
        print(json.dumps(info))
        return 0
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(
        f'{info["path"]}: {info["duration_s"]:.1f} s, {info["messages"]} messages, {info["bytes"] / 1e6:.1f} MB'
    )
    for key, value in info['provenance'].items():
        console.print(f'  {key}: {value}', highlight=False)
    table = Table()
    for column in ('topic', 'type', 'messages', 'rate Hz', 'largest gap s'):
        table.add_column(column, justify='left' if column in ('topic', 'type') else 'right')
    for topic in info['topics']:
        table.add_row(
            topic['topic'],
            topic['type'],
            str(topic['messages']),
            f'{topic["rate_hz"]:.1f}',
            f'{topic["largest_gap_s"]:.2f}',
        )
    console.print(table)
    if info['episodes']:
        console.print(
            f'{len(info["episodes"])} episodes: {", ".join(info["episodes"][:8])}'
            + (' ...' if len(info['episodes']) > 8 else '')
        )
    return 0
