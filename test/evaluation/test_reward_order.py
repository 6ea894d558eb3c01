"""Every benchmark type can be solved, and the reward agrees: the expert earns more than any driver that fails."""

import multiprocessing
import sys

import pytest

from raw2drive_ros.evaluation.suite_plans import benchmark_types
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.report.reward_plot import RewardTrace, trace

BAD = ('constant', 'idm', 'rule', 'random')
Jobs = list[tuple[str, str]]


def unmeasured() -> None:
    """In a worker: coverage traces it too, loses what it saw when the pool ends, and doubles the time."""
    sys.settrace(None)


def drive(job: tuple[str, str]) -> RewardTrace:
    from raw2drive_ros.evaluation.driver_spec import DriverSpec

    name, kind = job
    route = next(route for route in load_suite('b2d220').routes if route.type == kind)
    return trace(route, DriverSpec(name).build())


@pytest.fixture(scope='module')
def traces() -> dict[tuple[str, str], RewardTrace]:
    """The first `b2d220` route of every type, by the expert and by four others."""
    jobs = [(name, kind) for kind in benchmark_types() for name in ('expert', *BAD)]
    with multiprocessing.get_context('spawn').Pool(2, unmeasured) as pool:
        return dict(zip(jobs, pool.imap(drive, jobs), strict=True))


@pytest.mark.parametrize('kind', benchmark_types())
def test_the_expert_succeeds_and_earns_more_than_whoever_fails(traces, kind) -> None:
    expert = traces['expert', kind]
    assert expert.result.success, expert.result
    failed = {name: traces[name, kind] for name in BAD if not traces[name, kind].result.success}
    assert 'random' in failed
    for name, other in failed.items():
        assert expert.discounted_return > other.discounted_return, (name, other.result)
