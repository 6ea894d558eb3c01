"""`raw2drive bag`: the doctor, the events, and the verbs on the command line."""

import json

import pytest
from recording_helpers import messages_of

from msg_adapters.diagnostics import diagnostics_to_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_writer import BagWriter


def test_the_doctor_finds_nothing_wrong_with_a_good_bag(bag, capsys) -> None:
    assert [c for c in examine(bag) if c.severity != 'note'] == []
    assert main(['bag', 'doctor', str(bag)]) == 0
    assert 'fit for use' in capsys.readouterr().out


def test_the_doctor_names_gaps_missing_topics_and_incomplete_ticks(bag, tmp_path, capsys) -> None:
    with BagWriter(tmp_path / 'holes') as writer:
        for count, (topic, stamp, data) in enumerate(messages_of(bag)):
            lost = topic == topics.IMU or (topic == topics.image_topic('back') and 600 < count < 900)
            if not lost:
                writer.write_raw(topic, stamp, data)
    texts = [f'{c.severity}: {c.text}' for c in examine(tmp_path / 'holes')]
    assert f'warning: {topics.IMU} is missing' in texts
    assert any(t.startswith(f'warning: {topics.image_topic("back")}: a gap of') for t in texts)
    assert any('ticks are incomplete' in t for t in texts)
    (tmp_path / 'holes' / 'metadata.yaml').unlink()
    assert main(['bag', 'doctor', str(tmp_path / 'holes'), '--json']) == 1
    assert json.loads(capsys.readouterr().out)[0]['severity'] == 'error'


def test_bag_verbs_on_the_command_line(bag, tmp_path, capsys) -> None:
    out = tmp_path / 'x'
    assert main(['bag', 'cut', str(bag), '--start', '1', '--end', '2', '--out', str(out), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['messages'][topics.IMU] == pytest.approx(20, abs=1)
    assert main(['bag', 'merge', str(out), str(out), '--out', str(tmp_path / 'y')]) == 0
    assert main(['bag', 'recover', str(out), '--out', str(tmp_path / 'z')]) == 0
    capsys.readouterr()
    assert main(['bag', 'cut', str(bag), '--start', '1']) == 2
    assert 'needs --out' in capsys.readouterr().err
    assert main(['bag', 'recover', str(out), '--out', str(tmp_path / 'z')]) == 1
    assert 'exists already' in capsys.readouterr().err


def test_events_are_changes_of_what_nodes_say_of_themselves(tmp_path, capsys) -> None:
    factory = RosbagsFactory()
    with BagWriter(tmp_path / 'bag', {}) as writer:
        for tick, (node, level, text) in enumerate(
            [
                ('planner', 0, 'driving'),
                ('safety_gate', 0, 'driving'),
                ('planner', 2, 'stop: camera front: newest is 0.31 s old'),
                ('planner', 2, 'stop: camera front: newest is 1.31 s old'),
                ('safety_gate', 2, '[bold]no valid proposal[/bold]'),
                ('planner', 0, 'driving'),
            ]
        ):
            message = diagnostics_to_message(factory, node, level, text, {}, 0)
            data = factory.serialize(message, 'diagnostic_msgs/msg/DiagnosticArray')
            writer.write_raw(topics.DIAGNOSTICS, (tick + 1) * 10**9, data)
    assert main(['bag', 'events', str(tmp_path / 'bag'), '--json']) == 0
    events = json.loads(capsys.readouterr().out)
    assert [(e['time_s'], e['node'], e['level']) for e in events] == [
        (0.0, 'planner', 'ok'),
        (1.0, 'safety_gate', 'ok'),
        (2.0, 'planner', 'error'),
        (4.0, 'safety_gate', 'error'),
        (5.0, 'planner', 'ok'),
    ]
    assert main(['bag', 'events', str(tmp_path / 'bag')]) == 0
    assert '[bold]no valid' in capsys.readouterr().out
