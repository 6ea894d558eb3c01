"""raw2drive faults: list the plans, or put the injector into a running graph."""

from __future__ import annotations

import argparse

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments
from raw2drive_ros.cli.parser import at_least, refuse_all_but

EXAMPLES = """examples:
  raw2drive faults list
  raw2drive faults list my_plans.yaml
  raw2drive faults run 'camera frozen' --domain 12        between the nodes of a graph; says what to remap
  raw2drive demo --fault 'camera frozen'                  the same with the whole graph around it
  raw2drive evaluate faults                               scores and reaction times under every plan"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('action', choices=('list', 'run'))
    parser.add_argument('plan', nargs='?', help='run: a plan; list: a file')
    parser.add_argument('--plans', default='matrix', help='run: name of a file in params/faults, or a YAML file')
    parser.add_argument('--seed', type=int, help="of what is drawn by chance (default: the file's)")
    add_domain_argument(parser)
    parser.add_argument('--sim-time', action='store_true', help='the graph runs by /clock')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.faults.plan import AMOUNTS, behind_injector, load_plan, load_plans, touched_topics

    if options.action == 'list':
        refuse_all_but(options, ['action', 'plan' if options.plan else 'plans'], 'faults list FILE')
        file = load_plans(options.plan or options.plans)
        for name, faults in file.plans.items():
            print(name)
            for fault in faults:
                amount = AMOUNTS[fault.kind]
                how = f', {fault.strength:g} ({amount[0]})' if amount else ''
                print(f'    {fault.kind} {fault.topic}{how}, from {fault.start_s:g} s for {fault.duration_s:g} s')
        return 0
    at_least(options, 0, 'seed')
    if options.plan is None:
        raise UsageError(f'faults run: give a plan of {options.plans}: {", ".join(load_plans(options.plans).plans)}')
    faults = load_plan(options.plans, options.plan)
    from raw2drive_ros.graph.foreground import run_single

    print('start the nodes that are to receive the faulty messages with:')
    for name in touched_topics(faults):
        print(f'    --ros-args -r {options.namespace}{name}:={options.namespace}{behind_injector(name)}')
    # The node takes -1 for the file's own seed.
    seed = -1 if options.seed is None else options.seed
    parameters = {'plans': options.plans, 'plan': options.plan, 'seed': seed}
    return run_single(
        {'fault_injector': parameters}, options.domain, namespace=options.namespace, sim_time=options.sim_time
    )
