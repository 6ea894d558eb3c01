"""Options that would be without effect, values out of range and mistyped names: one line, exit code 2, nothing done."""

import json

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.near_names import near_names, unknown_name
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.faults.plan import load_plans

RUN = ['--run', 'runs/never']


def words_of(value: list[str] | str) -> str:
    return ' '.join(value) if isinstance(value, list) else value.split()[0]


def outcome(words: list[str], capsys) -> tuple[int, str]:
    """(exit code, stderr) of a command that must not print anything on stdout."""
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    printed = capsys.readouterr()
    assert printed.out == ''
    assert len(printed.err.splitlines()) == 1, printed.err
    return code, printed.err


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['evaluate', '--suite', 'dev10', '--routes', 'all'], '--routes: does not go with --suite'),
        (['evaluate', '--suite', 'dev10', '--first-seed', '3'], '--first-seed: does not go with --suite'),
        (['evaluate', '--first-seed', '-1'], '--first-seed -1: give 0 or more'),
        (['evaluate', '--seeds', '0'], '--seeds 0: give 1 or more'),
        (['evaluate', '--threads', '0'], '--threads 0: give 1 or more'),
        (['evaluate', '--driver', 'rule', '--bundle', 'x'], '--bundle: is for raw'),
        (['evaluate', '--driver', 'raw', '--run', 'x'], '--run: is for privileged'),
        (['evaluate', '--driver', 'rule', '--threads', '2'], '--threads: is for raw, privileged'),
        (['evaluate', '--driver', 'rule', '--blind'], '--blind: driver rule does not look'),
        (['evaluate', '--graph', '--threads', '2'], '--threads: the nodes of --graph'),
        (['evaluate', 'faults', '--suite', 'dev10', '--routes', 'all'], '--routes: does not go with --suite'),
        (['evaluate', 'faults', '--workers', '0'], '--workers 0: give 1 or more'),
        (['collect', '--driver', 'raw', '--noise', '0.1', '--out', 'runs/never'], '--noise: driver raw takes none'),
        (['collect', '--driver', 'idm', '--noise', '0.1', '--out', 'runs/never'], '--noise: driver idm takes none'),
        (['collect', '--noise', '2', '--out', 'runs/never'], '--noise 2: a chance per tick'),
        (['collect', '--seed', '-1', '--out', 'runs/never'], '--seed -1: give 0 or more'),
        (['collect', '--ticks', '0', '--out', 'runs/never'], '--ticks 0: give 1 or more'),
        (['collect', '--episode-ticks', '0', '--out', 'runs/never'], '--episode-ticks 0: give 1 or more'),
        (['collect', '--stand-ticks', '-1', '--out', 'runs/never'], '--stand-ticks -1: give 0 or more'),
        (['collect', '--advice-every', '8', '--out', 'runs/never'], '--advice-every: goes with --advice'),
        (['collect', '--driver', 'rule', '--run', 'x', '--out', 'runs/never'], '--run: is for privileged'),
        (['collect', '--driver', 'privileged', '--table', '--out', 'runs/never'], '--table: driver privileged drives'),
        (['collect', '--no-cameras', '--size', '64x96', '--out', 'runs/never'], '--size: is of the camera images'),
        (['collect', '--no-cameras', '--vary', '--out', 'runs/never'], '--vary: is of the camera images'),
        (['collect', '--driver', 'raw', '--no-cameras', '--out', 'runs/never'], '--no-cameras: driver raw drives by'),
        (['train', 'privileged', '--bags', 'bags'], 'give --run'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--teacher', 'x'], '--teacher: is for stage raw'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--workers', '3'], '--workers: goes with --recipe'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--steps', '0'], '--steps 0: give 1 or more'),
        (['train', 'privileged', '--recipe', 'teacher', *RUN, '--steps', '9'], '--steps: is fixed by --recipe'),
        (['train', 'privileged', '--recipe', 'teacher', *RUN, '--preset', 'nano'], '--preset: is fixed by --recipe'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--set', 'seed'], '--set help lists the fields'),
        (['scenario', 'list', '--seed', '3'], '--seed: scenario list takes no such option'),
        (['scenario', 'show', 'Accident', '--against', 'idm'], '--against: scenario show takes no such option'),
        (['scenario', 'reward', 'Accident', '--video', 'a.mp4'], '--video: scenario reward takes no such option'),
        (['scenario', 'reward', 'Accident', '--seed', '-1'], '--seed -1: give 0 or more'),
        (['scenario', 'reward', 'Accident', '--bundle', 'x'], '--bundle: is for raw'),
        (['suite', 'list', '--out', 'x'], '--out: suite list takes no such option'),
        (['suite', 'show', 'dev10', '--version', '3'], '--version: suite show takes no such option'),
        (['suite', 'show'], 'suite show needs a name'),
        (['faults', 'list', '--seed', '3'], '--seed: faults list FILE takes no such option'),
        (['faults', 'run', 'camera frozen', '--seed', '-3'], '--seed -3: give 0 or more'),
        (['soak', '--graphs', '2', '--domain', '12'], '--domain: several graphs choose'),
        (['report', 'x.jsonl', '--json', '--out', 'a.html'], '--out: is of the page'),
        (['doctor', '--quick', '--bundle', 'x'], '--bundle: its latency'),
        (['demo', '--fault-plans', 'matrix'], '--fault-plans: goes with --fault'),
        (['adapt', 'twist', '--horizon', '0'], '--horizon must be positive'),
        (['carla', '--seed', '-1'], '--seed -1: give 0 or more'),
    ],
    ids=words_of,
)
def test_an_option_without_effect_or_out_of_range_is_an_error(words, message, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, error = outcome(words, capsys)
    assert code == 2
    assert message in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ('words', 'suggestion'),
    [
        (['evalute'], 'did you mean evaluate'),
        (['evaluate', 'fault'], 'did you mean evaluate faults?'),
        (['evaluate', '--drivr', 'rule'], 'did you mean --driver?'),
        (['bag', 'inof', 'x'], 'did you mean info?'),
        (['evaluate', '--driver', 'exprt'], 'did you mean expert?'),
        (['collect', '--driver', 'privleged', '--out', 'x'], 'did you mean privileged'),
        (['scenario', 'show', 'Acident'], 'did you mean Accident or AccidentTwoWays?'),
        (['sim', '--scenario', 'parkingexit'], 'did you mean ParkingExit?'),
        (['evaluate', '--driver', 'rule', '--routes', 'mergin'], 'did you mean Merging?'),
        (['evaluate', '--driver', 'rule', '--suite', 'dev1'], 'did you mean dev10?'),
        (['evaluate', '--driver', 'rule', '--suite', 'dev10', '--ability', 'mergin'], 'did you mean Merging?'),
        (['suite', 'build', 'b2d22', '--out', 'x'], 'did you mean b2d220?'),
        (['evaluate', '--driver', 'rule', '--weather', 'HardRainNigt'], 'did you mean HardRainNight'),
        (['evaluate', 'faults', '--plans', 'matrx'], 'did you mean matrix?'),
        (['faults', 'run', 'camera frozn'], 'did you mean camera frozen'),
        (['demo', '--fault', 'camera frozn'], 'did you mean camera frozen'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--preset', 'labtop'], 'did you mean laptop'),
        (['train', 'privileged', '--recipe', 'techer', *RUN], 'did you mean teacher?'),
        (['train', 'privileged', '--bags', 'bags', *RUN, '--set', 'polcy_lr=1'], 'did you mean policy_lr'),
    ],
    ids=words_of,
)
def test_a_mistyped_name_comes_with_the_ones_that_are_near(words, suggestion, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, error = outcome(words, capsys)
    assert code == 2
    assert suggestion in error


def test_mistyped_topics_and_keys_of_files_too(tmp_path) -> None:
    plans = tmp_path / 'plans.yaml'
    plans.write_text('plans: {lost: [{topic: /vehicle/odometri, kind: drop}]}\n')
    with pytest.raises(ConfigError, match=r"no topic is called '/vehicle/odometri'; did you mean /vehicle/odometry"):
        load_plans(str(plans))
    plans.write_text('plan: {lost: [{topic: /vehicle/odometry, kind: drop}]}\n')
    with pytest.raises(ConfigError, match=r'plan: no such key; did you mean plans\?'):
        load_plans(str(plans))
    gate = tmp_path / 'gate.yaml'
    gate.write_text('motion: {max_sped_mps: 3.0}\n')
    with pytest.raises(ConfigError, match=r'motion\.max_sped_mps: no such key; did you mean max_speed_mps'):
        load_gate_config(gate)


def test_near_names_are_sorted_few_and_without_guesses() -> None:
    assert near_names('LEFT', ['left', 'lefty']) == ['left']
    assert near_names('qqq', ['left', 'right']) == []
    assert len(near_names('name0', [f'name{n}' for n in range(1, 9)])) == 3
    many = [f'name{n}' for n in range(99)]
    assert unknown_name('thing', 'nome1', many).startswith("unknown thing 'nome1'; did you mean name1")
    assert 'known:' not in unknown_name('thing', 'nome1', many), 'a list of 99 would hide the suggestion'
    assert unknown_name('thing', 'x', ['left']) == "unknown thing 'x'; known: left"


def test_what_is_given_twice_or_as_the_default_is_given(capsys) -> None:
    """Not the value counts but that the user wrote the option."""
    words = ['evaluate', '--suite', 'dev10', '--routes', 'lane-following']
    assert outcome(words, capsys)[1].startswith('error: --routes')


def test_a_suite_is_shown_route_by_route(capsys) -> None:
    assert main(['suite', 'show', 'b2d220', '--json']) == 0
    body = json.loads(capsys.readouterr().out)
    assert (body['suite'], body['version'], len(body['routes'])) == ('b2d220', '2', 220)
    assert main(['suite', 'show', 'dev10']) == 0
    printed = capsys.readouterr().out
    assert 'SignalizedJunctionLeftTurnEnterFlow │    0 │ ClearNight      │ Merging, TrafficSign' in printed
    assert printed.splitlines()[-1] == 'drive them: raw2drive evaluate --suite dev10'
