"""Entry point: parses the verb, imports its module, maps errors to one line and an exit code."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Collection, Sequence

from raw2drive_ros import __version__
from raw2drive_ros.cli.parser import Parser

# group: verb: (module, one line of help). A verb of two words is a subcommand of the verb that its first word names.
GROUPS = {
    'Start': {
        'demo': ('demo', 'drive three routes through the whole ROS graph and make a report'),
        'doctor': ('doctor', 'check the installation, the transport and the latency budget'),
        'completion': ('completion', 'print the script that completes this command in bash or zsh'),
    },
    'Drive': {
        'sim': ('sim', 'run the simulation bridge'),
        'drive': ('drive', 'run planner and safety gate on a graph that has a vehicle'),
        'check-vehicle': ('check_vehicle', 'probe a graph that claims to be a vehicle: what breaks the contract?'),
        'adapt': ('adapt', 'translate commands for a vehicle that takes TwistStamped, Ackermann, Autoware or CARLA'),
        'carla': ('carla', 'a car of a CARLA server as the vehicle'),
        'call': ('call', 'call a service of a running node: activate, pause, reset, seek'),
        'faults': ('faults', 'list plans of faults, or put the fault injector into a running graph'),
        'attack': ('attack', 'attack a running graph in 36 ways: does the car stand, and is it logged?'),
        'security': ('security', 'write access control policies for SROS2'),
        'soak': ('soak', 'run the whole graph for hours: do memory, handles and logs stay flat?'),
    },
    'Learn': {
        'collect': ('collect', 'drive in process and write training bags'),
        'train': ('train', 'train the privileged (stage 1) or raw (stage 2) stream from bags'),
    },
    'Evaluate': {
        'evaluate': ('evaluate', 'drive routes in process or through the graph, and score them'),
        'evaluate faults': ('evaluate_faults', 'drive the raw policy under every plan of faults'),
        'report': ('report', 'compare results of evaluate on one HTML page'),
        'suite': ('suite', 'list the evaluation suites, show the routes of one, or draw one anew'),
    },
    'Look': {
        'scenario': ('scenario', 'list the scenario types, or show one as a picture or a video'),
        'curves': ('curves', 'draw the metrics of training runs as one picture'),
        'calibration': ('calibration', 'compare what a world model and its critic predict with what bags recorded'),
        'dream': ('dream', 'film what a world model believes and imagines at a moment of a bag'),
    },
    'Bags': {
        'record': ('record', 'record a running graph into an MCAP bag'),
        'replay': ('replay', "play a bag's sensors into the graph"),
        'bag': ('bag', 'inspect, mend, cut and merge bags'),
    },
}
VERBS = {verb: entry for verbs in GROUPS.values() for verb, entry in verbs.items()}
EXAMPLES = """examples:
  raw2drive demo                                   the whole graph on three routes, with report
  raw2drive evaluate --driver raw --routes lane-following --seeds 20
  raw2drive collect --driver rule --ticks 20000 --out runs/bags/rule
  raw2drive train privileged --bags runs/bags --run runs/stage1
  raw2drive bag info runs/demo/bag

`raw2drive VERB --help` explains a verb."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit codes: 0 done, 1 failed, 2 wrong usage, 130 Ctrl-C, 143 SIGTERM."""
    words = _joined(list(sys.argv[1:] if arguments is None else arguments))
    chosen = next((a for a in words if not a.startswith('-')), '')
    parser, verbs = build_parser((chosen,))
    options, unknown = parser.parse_known_args(words)
    sub = verbs[options.verb]
    two_words = [verb for verb in VERBS if verb.startswith(f'{options.verb} ')]
    sub.refuse_unknown(unknown, two_words)
    # Which options the user gave: `parser.refuse` tells them from defaults.
    options.given = sub.named(words[words.index(options.verb) + 1 :])
    from raw2drive_ros.cli.guard import guarded

    return guarded(options.run, options)


def build_parser(loaded: Collection[str]) -> tuple[Parser, dict[str, Parser]]:
    """The parser of the command line, and those of the verbs, of which only the `loaded` ones know their options."""
    parser = Parser(
        'raw2drive',
        description='Raw2Drive for ROS 2: an end-to-end driver learnt by model-based reinforcement learning.',
        epilog=f'{_listing()}\n\n{EXAMPLES}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'raw2drive {__version__}')
    verbs = parser.add_subparsers(dest='verb', metavar='VERB', required=True)
    subs: dict[str, Parser] = {}
    for verb, (module, help_line) in VERBS.items():
        # No `help` here, or argparse would list the verbs a second time.
        subs[verb] = verbs.add_parser(verb, description=help_line, formatter_class=argparse.RawDescriptionHelpFormatter)
        if verb in loaded:
            found = importlib.import_module(f'raw2drive_ros.cli.{module}')
            subs[verb].epilog = found.EXAMPLES
            found.add_arguments(subs[verb])
            subs[verb].set_defaults(run=found.run)
    return parser, subs


def _listing() -> str:
    """Every verb with its line, by group."""
    width = max(map(len, VERBS)) + 2
    return '\n\n'.join(
        '\n'.join([f'{group}:', *(f'  {verb:{width}}{line}' for verb, (_, line) in verbs.items())])
        for group, verbs in GROUPS.items()
    )


def _joined(given: list[str]) -> list[str]:
    """`evaluate faults` is one verb of two words."""
    return [' '.join(given[:2]), *given[2:]] if ' '.join(given[:2]) in VERBS else given


if __name__ == '__main__':
    raise SystemExit(main())
