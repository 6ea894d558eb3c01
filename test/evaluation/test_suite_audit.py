"""The audit finds what can be won without looking: a type without substance is soft, one that needs eyes is not."""

import json

import paired_types
import pytest
from paired_types import EMPTY, WALKER

from raw2drive_ros.cli.main import main
from raw2drive_ros.evaluation import cheat_tuning, cheats
from raw2drive_ros.evaluation.cheat_tuning import Course, Trials, TuneSettings, search, together, tune
from raw2drive_ros.evaluation.cheats import FAMILIES, SCRIPT, SIGHTLESS, Choice, Tuned, load_tuned
from raw2drive_ros.evaluation.quick_drive import sensorless_env
from raw2drive_ros.evaluation.reference import References
from raw2drive_ros.evaluation.sightless import Profile, Stop
from raw2drive_ros.evaluation.suite_audit import (
    HINDSIGHT,
    AuditRow,
    audit,
    bar_percent,
    faults_of,
    first_differences,
    percent_of,
    table_of,
)
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.simulation.route_id import RouteId

RULE = References('rule', '')


@pytest.fixture(autouse=True)
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def suite_file(tmp_path, name, kind, seeds, limits=(40.0, 25.0)):
    places = [{'seed': s, 'weather': 'ClearNoon', 'limit_s': list(limits), 'reference_s': [9.0, 9.0]} for s in seeds]
    path = tmp_path / f'{name}.json'
    path.write_text(json.dumps({'format': 3, 'name': name, 'version': '3', 'routes': {kind: places}}))
    return str(path)


def only(monkeypatch, *families) -> None:
    """So that a test does not try hundreds of profiles."""
    for name in set(FAMILIES) - set(families):
        monkeypatch.delitem(FAMILIES, name)


def rows_of(driver, kind, won, of):
    return [AuditRow(driver, kind, seed, (seed < won, seed < won), ('', ''), {}) for seed in range(of)]


def test_a_pair_is_won_by_both_drives_alone(tmp_path) -> None:
    suite = load_suite(suite_file(tmp_path, 'own', WALKER, [0, 1]))
    fast = {
        'blind': {WALKER: Choice('blind', Profile())},
        'creep': {WALKER: Choice('creep', Profile(5.0, sensor=True))},
    }
    rows = list(audit(suite, Tuned(fast), ('blind', 'creep')))
    assert [(row.driver, row.won) for row in rows[:2]] == [('blind', (False, True)), ('creep', (True, False))]
    assert rows[0].causes == ('collision_pedestrian', '')
    assert rows[1].causes == ('', 'timeout')
    table = table_of(rows)
    assert (table['blind'][WALKER].pairs, table['creep'][WALKER].events) == (0, 2)
    assert percent_of(table['blind'].values()) == 0.0
    assert faults_of(table) == []


def test_bars_name_the_driver_and_its_types() -> None:
    assert (bar_percent('creep'), bar_percent(SCRIPT), bar_percent(HINDSIGHT)) == (5.0, 12.0, 100.0)
    hard = [row for number in range(40) for row in rows_of('creep', f'Hard{number}', 0, 5)]
    three = [row for number in range(3) for row in rows_of('creep', f'Soft{number}', 3, 5)]
    assert faults_of(table_of([*hard, *three])) == []
    four = [*three, *rows_of('creep', 'Soft3', 3, 5)]
    faults = faults_of(table_of([*hard, *four]))
    assert faults[0].startswith('creep wins 5.5 % of the pairs: more than 5 %')
    assert faults[1] == 'creep wins more than 2 of 5 pairs of 4 types: Soft0, Soft1, Soft2, Soft3'
    # Two of five is not soft.
    fair = [row for number in range(9) for row in rows_of('wait', f'T{number}', 2, 5)]
    assert not any('types' in fault for fault in faults_of(table_of(fair)))


def test_the_search_finds_the_speed_that_fits_the_limits() -> None:
    """Only between 4.5 and 6 m/s does a constant speed keep both limits of a road that has nothing on it."""
    drives = [(RouteId(EMPTY, seed), RouteId(EMPTY, seed, twin=True)) for seed in (100_000, 100_001)]
    courses = [Course(pair, (26.0, 26.0)) for pair in drives]
    found = search('crawl', Trials(sensorless_env(), courses))
    assert (found.won, found.of) == (2, 2)
    assert 3.0 < found.way.speed_mps < 12.0
    never = [Course(pair, (5.0, 5.0)) for pair in drives]
    trials = Trials(sensorless_env(), never)
    assert search('crawl', trials).won == 0
    # Nothing was driven for it: the limits alone rule every speed out.
    assert trials.known == {}


def test_a_profile_that_differs_after_a_failure_is_not_driven_again(monkeypatch) -> None:
    """What is left out would have failed: the same stops are driven without the short cut."""
    drives = tuple(RouteId(WALKER, seed) for seed in (100_000, 100_001))
    env = sensorless_env()
    ways = [Profile(stops=(Stop(at, 4.0),)) for at in (0.3, 0.5, 0.7, 0.9)] + [Profile(slow=(0.8, 0.9, 2.0))]
    trials = Trials(env, [Course((route,), (None,)) for route in drives])
    assert trials.wins(Profile(), 0) == trials.wins(Profile(), 1) == (False, False)
    driven = []
    original = cheat_tuning.quick_drive
    monkeypatch.setattr(cheat_tuning, 'quick_drive', lambda *given: driven.append(given[2]) or original(*given))
    found = [trials.wins(way, number) for way in ways for number in (0, 1)]
    assert 0 < len(driven) < len(found)
    every = Trials(env, trials.courses)
    assert found == [every.wins(way, number) for way in ways for number in (0, 1)]
    assert any(whole for whole, _ in found)


def test_tuning_takes_limits_and_memories_from_the_reference_driver(tmp_path, monkeypatch) -> None:
    only(monkeypatch, 'crawl', 'memoriser')
    train = load_suite(suite_file(tmp_path, 'train', EMPTY, [100_000, 100_001, 100_002], limits=(60.0, 60.0)))
    (found,) = tune(train, [EMPTY, WALKER], TuneSettings(RULE, pairs=2))
    assert found.type == EMPTY
    assert set(found.choices) == {'crawl', 'memoriser', SCRIPT}
    assert {(m.seed, m.twin) for m in found.memories} == {(s, t) for s in (100_000, 100_001) for t in (False, True)}
    assert found.choices['memoriser'].won == 2
    assert found.choices[SCRIPT] is found.choices['crawl']
    # The first speed that keeps the stored limits, which are looser than the rule's.
    assert found.choices['crawl'].way.speed_mps <= 3.0
    assert next(tune(train, [EMPTY], TuneSettings(RULE, pairs=2))).choices == found.choices
    both = together([found], Tuned({'crawl': {WALKER: Choice('crawl', Profile(1.0))}}, ()))
    assert set(both.choices['crawl']) == {EMPTY, WALKER}


def test_hindsight_shows_whether_any_profile_wins(tmp_path) -> None:
    suite = load_suite(suite_file(tmp_path, 'own', EMPTY, [0]))
    (row,) = audit(suite, Tuned(), (HINDSIGHT,))
    assert row.pair
    tight = load_suite(suite_file(tmp_path, 'tight', EMPTY, [0], limits=(40.0, 8.0)))
    (row,) = audit(tight, Tuned(), (HINDSIGHT,))
    assert not row.pair
    assert faults_of(table_of([row])) == []


def test_where_twins_begin_to_differ_is_told(tmp_path) -> None:
    suite = load_suite(suite_file(tmp_path, 'own', WALKER, [0]))
    (alike,) = first_differences(suite, [WALKER])
    assert str(alike).endswith('m (walker)')
    assert first_differences(load_suite('dev10'), ['LongRoute']) == []


def test_a_soft_suite_fails_on_the_command_line(tmp_path, monkeypatch, capsys) -> None:
    only(monkeypatch, 'crawl', 'creep')
    monkeypatch.setattr(cheats, 'SIGHTLESS', ('crawl', 'creep', SCRIPT))
    train = suite_file(tmp_path, 'train', EMPTY, [100_000, 100_001])
    choices, rows = tmp_path / 'choices', tmp_path / 'rows.jsonl'
    words = ['--reference', 'rule', '--pairs', '2']
    assert main(['suite', 'tune', train, '--out', str(choices), *words]) == 0
    assert EMPTY in capsys.readouterr().out
    assert load_tuned(choices).choices[SCRIPT][EMPTY].won == 2
    soft = suite_file(tmp_path, 'soft', EMPTY, [0, 1, 2])
    assert main(['suite', 'audit', soft, '--choices', str(choices), '--out', str(rows)]) == 1
    printed = capsys.readouterr()
    assert 'too soft: crawl wins 100.0 % of the pairs' in printed.err
    assert '3/3' in printed.out
    assert len(rows.read_text().splitlines()) == 9
    hard = suite_file(tmp_path, 'hard', EMPTY, [0, 1, 2], limits=(40.0, 7.0))
    assert main(['suite', 'audit', hard, '--choices', str(choices), '--json']) == 0
    body = json.loads(capsys.readouterr().out)
    assert body['faults'] == []
    assert body['drivers']['creep']['pair_success_percent'] == 0.0
    assert body['alike_until'] == {EMPTY: 'never'}
    # Types for which nothing was chosen are tuned first.
    empty = tmp_path / 'nothing'
    cheats.save_tuned(empty, Tuned())
    words += ['--choices', str(empty), '--train', train, '--drivers', 'crawl']
    assert main(['suite', 'audit', soft, *words]) == 1
    assert 'tuning 1 types' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        (['audit'], 'needs a suite'),
        (['audit', 'dev10', '--drivers', 'crepe'], 'did you mean creep'),
        (['audit', 'dev10', '--types', 'Acident'], 'unknown type'),
        (['tune', 'train'], '--out FOLDER'),
        (['tune', 'train', '--out', 'x', '--json'], '--json: suite tune takes no such option'),
        (['audit', 'dev10', '--pairs', '0'], '--pairs 0'),
    ],
)
def test_wrong_usage_is_one_line(words, reason, capsys) -> None:
    assert main(['suite', *words]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count('\n') == 1


def test_all_sightless_drivers_are_audited_by_default() -> None:
    assert set(SIGHTLESS) == {
        *('creep', 'wait', 'crawl', 'straddle_left', 'straddle_right', 'blind', 'memoriser', 'profile', 'script')
    }
