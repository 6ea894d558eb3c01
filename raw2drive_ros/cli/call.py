"""raw2drive call: a service of a running node, without the `ros2` command that pip does not install."""

from __future__ import annotations

import argparse

from raw2drive_ros.cli.domain_option import add_domain_argument, nothing_there
from raw2drive_ros.cli.graph_options import add_graph_arguments

EXAMPLES = """examples:
  raw2drive call                                        what can be called in this domain
  raw2drive call /safety_gate/activate                  drive on after a latched stop; the car must stand
  raw2drive call /bridge/pause true
  raw2drive call /bridge/reset --set scenario=Accident --set seed=3
  raw2drive call /player/seek --set start_s=12 --domain 7
  raw2drive call /planner/change_state deactivate       configure, activate, deactivate, cleanup

--set sets parameters of the service's node first, all or none. Options come last.
Exit code 1: no such service, or it refused."""


# What the node says, see nodes/service_call.py, when there is nothing to call at all.
NOBODY = 'is a graph running'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('service', nargs='?', default='', help='full name; without one, list them')
    parser.add_argument('argument', nargs='?', default='', help='true or false, or the name of a transition')
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE', help='may be given several times')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    import json
    import tempfile
    from pathlib import Path

    from raw2drive_ros.contracts.errors import GraphError, UsageError
    from raw2drive_ros.graph.processes import running_graph

    if options.service and not options.service.startswith('/'):
        raise UsageError(f'{options.service}: give the full name, as /safety_gate/activate')
    pairs = [part.partition('=') for part in options.set]
    if not all(name and equals for name, equals, _ in pairs) or (pairs and not options.service):
        raise UsageError('--set wants NAME=VALUE, and a service')
    parameters = {
        'service': f'{options.namespace}{options.service}' if options.service else '',
        'argument': options.argument,
        'set': json.dumps({name: value for name, _, value in pairs}),
    }
    with (
        tempfile.TemporaryDirectory(prefix='raw2drive_') as folder,
        running_graph(Path(folder), options.domain) as graph,
    ):
        graph.start('service_call', parameters, sim_time=False)
        code = graph.processes['service_call'].wait()
        if code:
            words = graph.last_words('service_call')
            raise GraphError(nothing_there(options.domain) if NOBODY in words else f'{words} (domain {options.domain})')
        print((Path(folder) / 'service_call.log').read_text(), end='')
    return 0
