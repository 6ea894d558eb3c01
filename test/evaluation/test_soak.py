"""What counts as steady, and a soak of seconds with the real graph."""

import json

import numpy as np
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import SoakError
from raw2drive_ros.evaluation.soak import Sample, append_sample, drop_half_line, read_samples, theil_sen, totals, trends


def samples(part: int, hours: float, **values) -> list[Sample]:
    """One a simulated minute; values: name -> function of hours."""
    times = np.arange(0.0, hours + 1e-9, 1.0 / 60.0)
    return [
        Sample(part, t * 3600.0, t * 720.0, int(t * 100), {k.replace('__', '/'): f(t) for k, f in values.items()})
        for t in times
    ]


def test_slope_is_that_of_the_line_whatever_a_few_points_do() -> None:
    x = np.arange(100.0)
    y = 3.0 + 0.5 * x
    y[::7] += 1000.0
    assert theil_sen(x, y) == pytest.approx(0.5)
    assert theil_sen([1.0], [2.0]) == theil_sen([], []) == 0.0
    long = np.arange(5000.0)
    assert theil_sen(long, -2.0 * long) == pytest.approx(-2.0)


def test_leaks_are_found_and_what_only_warms_up_or_jitters_is_not() -> None:
    rng = np.random.default_rng(0)
    found = trends(
        samples(
            1,
            4.0,
            bridge__memory_mib=lambda t: 300.0 * (1.0 - np.exp(-t * 8.0)) + rng.normal(0.0, 2.0),
            planner__memory_mib=lambda t: 200.0 + 1.5 * t,
            planner__handles=lambda t: 23.0 + (rng.random() < 0.1),
            gate__handles=lambda t: 23.0 + int(2.0 * t),
            graph__logs_mib=lambda t: 0.5 * t,
        )
    )
    assert {t.name: t.steady for t in found} == {
        'bridge/memory_mib': True,
        'planner/memory_mib': False,
        'planner/handles': True,
        'gate/handles': False,
        'graph/logs_mib': True,
    }
    planner = next(t for t in found if t.name == 'planner/memory_mib')
    assert planner.per_hour == pytest.approx(1.5)
    assert planner.highest == pytest.approx(206.0)


def test_a_process_that_ends_is_judged_until_then() -> None:
    rows = samples(1, 3.0, a__handles=lambda t: 5.0, b__handles=lambda t: 7.0)
    rows[-1] = Sample(1, rows[-1].simulated_s, 0.0, 0, {'a/handles': 5.0})
    assert {t.name: t.last for t in trends(rows)} == {'a/handles': 5.0, 'b/handles': 7.0}


def test_each_start_is_judged_alone_and_short_ones_not_at_all() -> None:
    rows = samples(1, 1.9, a__memory_mib=lambda t: 9.0 * t) + samples(2, 3.0, a__memory_mib=lambda t: 500.0)
    assert [(t.part, t.steady) for t in trends(rows)] == [(2, True)]
    assert totals(rows) == pytest.approx({'simulated_h': 4.9, 'wall_h': 0.98, 'episodes': 490, 'parts': 2}, abs=0.02)


def test_a_killed_writer_costs_its_last_line_and_nonsense_is_named(tmp_path) -> None:
    file = tmp_path / 'samples.jsonl'
    rows = samples(1, 0.05, a__handles=lambda t: 1.0)
    for row in rows:
        append_sample(file, row)
    whole = file.read_text()
    file.write_text(whole + '{"part": 1, "simul')
    assert read_samples(file) == rows
    drop_half_line(file)
    assert file.read_text() == whole
    file.write_text(whole + '{"part": 1}\n')
    with pytest.raises(SoakError, match='line 5: not a sample of a soak'):
        read_samples(file)


def test_the_real_graph_is_soaked_and_goes_on_where_it_stopped(tmp_path, capsys) -> None:
    command = ['soak', '--out', str(tmp_path), '--every', '0.5', '--warm-up', '0', '--suite', 'dev10', '--json']
    for parts, graphs, hours in ((1, 1, 0.002), (3, 2, 0.006), (3, 1, 0.001)):
        code = main([*command, '--hours', str(hours), '--graphs', str(graphs)])
        told = json.loads(capsys.readouterr().out)
        assert code == (0 if told['steady'] else 1)
        assert told['parts'] == parts
        assert told['simulated_h'] >= hours
    quantities = {trend['name'] for trend in told['trends']}
    for process in ('bridge', 'planner', 'safety_gate', 'recorder'):
        assert {f'{process}/{q}' for q in ('memory_mib', 'handles', 'threads', 'shared_segments')} <= quantities
    by_name = {trend['name']: trend for trend in told['trends']}
    assert by_name['planner/memory_mib']['highest'] > 100.0
    assert by_name['bridge/shared_segments']['highest'] > 1.0
    assert (tmp_path / 'soak.png').stat().st_size > 10_000
