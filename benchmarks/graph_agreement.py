"""Does the ROS graph score a driver as the in-process evaluation does? Prints each route, and the verdict.

python -m benchmarks.graph_agreement [--driver rule] [--suite dev10]
"""

from __future__ import annotations

import argparse

from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.graph.drive import evaluate_graph
from raw2drive_ros.settings import default_bundle


def main() -> int:
    """Drive the suite both ways; exit code 1 when a row differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--driver', default='rule')
    parser.add_argument('--suite', default='dev10')
    options = parser.parse_args()
    suite = load_suite(options.suite)
    spec = DriverSpec(options.driver, default_bundle())
    graph = evaluate_graph(
        spec,
        suite.name,
        suite.version,
        suite.routes,
        Conditions(limits_s=suite.limits_s(suite.routes)),
        None,
        lambda done, row: None,
    )
    alone = evaluate(spec, suite.name, suite.version, suite.routes)
    for one, other in zip(graph['routes'], alone['routes'], strict=True):
        scores = f'{one["driving_score"]:6.1f} {other["driving_score"]:6.1f}'
        print(f'{one["id"]:60s} {scores} {"equal" if one == other else one}')
    same = graph['routes'] == alone['routes']
    print('equal' if same else 'DIFFERENT', f'on {len(suite.routes)} routes')
    for name, timing in (('graph', graph['timing']), ('in process', alone['timing'])):
        print(f'{name}: {timing["ticks_per_s"]} ticks/s, {timing["messages_lost"]} messages lost')
    return 0 if same else 1


if __name__ == '__main__':
    raise SystemExit(main())
