"""ROS_DOMAIN_ID is the default of --domain for every verb, and wrong values are one line."""

import argparse

import pytest

from msg_adapters.diagnostics import OK, diagnostics_to_message
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.cli.domain_option import VARIABLE, add_domain_argument
from raw2drive_ros.cli.main import VERBS, build_parser, main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import OdometrySample
from raw2drive_ros.graph import foreground
from raw2drive_ros.recording.bag_writer import BagWriter

PARSERS = build_parser(VERBS)[1]
WITH_DOMAIN = sorted(
    verb for verb, parser in PARSERS.items() if '--domain' in parser.format_help() and verb != 'attack'
)
# Arguments that a verb cannot do without.
NEEDED = {'adapt': ['twist'], 'faults': ['list'], 'record': ['--out', 'x'], 'replay': ['x']}


def parsed(verb: str, *more: str) -> argparse.Namespace:
    return build_parser([verb])[1][verb].parse_args([*NEEDED.get(verb, []), *more])


def test_every_verb_of_a_graph_has_the_option() -> None:
    ours = {'adapt', 'call', 'carla', 'check-vehicle', 'demo', 'drive', 'faults', 'record', 'replay', 'sim', 'soak'}
    assert ours <= set(WITH_DOMAIN)


def test_an_attack_goes_into_no_domain_that_it_was_not_told(monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, '11')
    assert parsed('attack').domain is None
    assert parsed('attack', '--domain', '12').domain == 12


@pytest.mark.parametrize('verb', WITH_DOMAIN)
def test_the_variable_is_the_default_and_the_option_wins(verb, monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, '11')
    assert parsed(verb).domain == 11
    assert parsed(verb, '--domain', '12').domain == 12
    assert 'domain' not in build_parser([verb])[1][verb].named(NEEDED.get(verb, []))
    for unset in (lambda: monkeypatch.delenv(VARIABLE), lambda: monkeypatch.setenv(VARIABLE, '')):
        unset()
        # A graph that is started whole takes the first free domain.
        assert parsed(verb).domain == (None if verb in ('demo', 'soak') else 0)


@pytest.mark.parametrize('value', ['abc', '-1', '102', '1.5', '1' * 99, '١'])
@pytest.mark.parametrize('verb', ['call', 'demo', 'sim'])
def test_a_wrong_variable_is_one_line_that_names_it(verb, value, monkeypatch, capsys) -> None:
    monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(SystemExit) as stop:
        main([verb])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert f'{VARIABLE}={value}: a ROS domain is a whole number from 0 to 101' in error
    assert len(error.splitlines()) == 1


def test_a_wrong_option_is_one_line_and_the_variable_does_not_matter_then(monkeypatch, capsys) -> None:
    monkeypatch.setenv(VARIABLE, 'abc')
    assert parsed('call', '--domain', '7').domain == 7
    with pytest.raises(SystemExit) as stop:
        main(['call', '--domain', '300'])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("error: argument --domain: '300': a ROS domain")
    assert VARIABLE not in error


def test_help_says_it() -> None:
    parser = argparse.ArgumentParser()
    add_domain_argument(parser, free=True)
    assert 'ROS_DOMAIN_ID, or else the first free one' in ' '.join(parser.format_help().split())


@pytest.mark.parametrize('heard', [True, False])
def test_record_says_when_it_heard_nobody(heard, monkeypatch, tmp_path, capsys) -> None:
    """The recorder always hears what it says of itself on /diagnostics."""

    def run_single(nodes, domain, **rest):
        assert domain == 11
        with BagWriter(tmp_path / 'bag') as bag:
            said = diagnostics_to_message(bag.factory, 'recorder', OK, 'recording', {}, 1_000)
            bag.write(topics.DIAGNOSTICS, 1_000, said)
            if heard:
                sample = OdometrySample(1_000, 0.0, 0.0, 0.0, 0.0, 0.0)
                bag.write(topics.ODOMETRY, 1_000, odometry_to_message(bag.factory, sample))
        return 0

    monkeypatch.setattr(foreground, 'run_single', run_single)
    monkeypatch.setenv(VARIABLE, '11')
    assert main(['record', '--out', str(tmp_path / 'bag')]) == 0
    assert ('listened in ROS domain 11; nothing there' in capsys.readouterr().err) != heard
