"""raw2drive bag: what a bag holds, whether it is fit for use, and new bags out of old ones."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.texts import shown

EXAMPLES = """examples:
  raw2drive bag info runs/demo/bag
  raw2drive bag info runs/demo/bag --json
  raw2drive bag events runs/demo/bag                                     stops, faults and recoveries, by time
  raw2drive bag doctor runs/demo/bag                                     what is missing, lost or out of order
  raw2drive bag recover runs/bags/monday --out runs/bags/monday_saved    after a kill or a crash
  raw2drive bag cut runs/demo/bag --start 12 --end 20 --out runs/turn
  raw2drive bag cut runs/demo/bag --topics '/sensing/*' '/vehicle/*' --out runs/sensors
  raw2drive bag merge runs/a runs/b --out runs/both

gap: the largest between two messages of a topic. Types are shown from 110 columns on, and by --json.
A recorder that was killed leaves .NAME.partial; give NAME, that folder, or the .mcap file in it."""
WIDE = 110


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('info', 'events', 'doctor', 'recover', 'cut', 'merge'))
    parser.add_argument('bags', type=Path, nargs='+', metavar='BAG')
    parser.add_argument('--out', type=Path, help='recover, cut, merge: folder of the new bag; must not exist')
    parser.add_argument('--start', type=float, default=0.0, help="cut: seconds after the bag's beginning")
    parser.add_argument('--end', type=float, default=float('inf'), help='cut: and before so many')
    parser.add_argument('--topics', nargs='+', default=['*'], help='cut: names or patterns')
    parser.add_argument('--json', action='store_true')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError

    if options.action != 'merge' and len(options.bags) != 1:
        raise UsageError(f'bag {options.action} takes one bag')
    if options.action in ('recover', 'cut', 'merge') and options.out is None:
        raise UsageError(f'bag {options.action} needs --out, the folder of the new bag')
    actions = {'info': _info, 'events': _events, 'doctor': _doctor, 'recover': _recover, 'cut': _cut, 'merge': _merge}
    return actions[options.action](options)


def _events(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from raw2drive_ros.cli.table import print_events
    from raw2drive_ros.recording.events import events_of

    events = events_of(options.bags[0])
    if options.json:
        print(json.dumps([asdict(event) for event in events]))
    elif events:
        print_events(events)
    else:
        print(f'{shown(options.bags[0])}: no node said anything of itself (no {topics.DIAGNOSTICS})')
    return 0


def _doctor(options: argparse.Namespace) -> int:
    """Exit code 1 when the bag has an error."""
    from dataclasses import asdict

    from raw2drive_ros.recording.bag_doctor import examine

    found = examine(options.bags[0])
    if options.json:
        print(json.dumps([asdict(complaint) for complaint in found]))
    else:
        for complaint in found:
            print(f'{complaint.severity}: {shown(complaint.text)}\n    {shown(complaint.remedy)}')
        if not any(complaint.severity != 'note' for complaint in found):
            print(f'{shown(options.bags[0])}: fit for use')
    return int(any(complaint.severity == 'error' for complaint in found))


def _recover(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.recover import recover

    found = recover(options.bags[0], options.out)
    _report(options, found.counts, found.lines())
    return 0


def _cut(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.bag_edit import cut
    from raw2drive_ros.recording.copying import Account

    account = Account()
    counts = cut(options.bags[0], options.out, options.start, options.end, tuple(options.topics), account)
    _report(options, counts, account.lines())
    return 0


def _merge(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.bag_edit import merge

    merged = merge(options.bags, options.out)
    lines = [f'{merged.doubled} messages were in several bags and are there once'] if merged.doubled else []
    _report(options, merged.counts, [*lines, *merged.account.lines()])
    return 0


def _report(options: argparse.Namespace, counts: dict[str, int], left_out: list[str]) -> None:
    """left_out: lines about what is not in the new bag; with --json, they are on stderr too."""
    for line in left_out:
        print(shown(line), file=sys.stderr)
    if options.json:
        print(json.dumps({'bag': str(options.out), 'messages': counts, 'left_out': left_out}))
        return
    print(f'{shown(options.out)}: {sum(counts.values())} messages of {len(counts)} topics, read again')


def _info(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.bag_info import bag_info

    info = bag_info(options.bags[0])
    if options.json:
        print(json.dumps(info))
    else:
        _print_info(info)
    return 0


def _print_info(info: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    # Names from a bag are no markup.
    console = Console(markup=False, emoji=False)
    console.print(
        f'{shown(info["path"])}: {info["duration_s"]:.1f} s, {info["messages"]} messages, {info["bytes"] / 1e6:.1f} MB'
    )
    for key, value in info['provenance'].items():
        console.print(f'  {shown(key)}: {shown(value)}', highlight=False)
    # Topic names are folded and never truncated; types are shown where there is room.
    wide = console.width >= WIDE
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column('topic', overflow='fold')
    if wide:
        table.add_column('type', no_wrap=True)
    for column in ('messages', 'rate Hz', 'gap s'):
        table.add_column(column, justify='right', no_wrap=True)
    for topic in info['topics']:
        figures = (str(topic['messages']), f'{topic["rate_hz"]:.1f}', f'{topic["largest_gap_s"]:.2f}')
        table.add_row(shown(topic['topic']), *([shown(topic['type'])] if wide else []), *figures)
    console.print(table)
    if info['episodes']:
        console.print(
            f'{len(info["episodes"])} episodes: {", ".join(map(shown, info["episodes"][:8]))}'
            + (' ...' if len(info['episodes']) > 8 else '')
        )
    if info['refused']:
        console.print(f'{len(info["refused"])} messages refused; the first: {info["refused"][0]}', markup=False)
