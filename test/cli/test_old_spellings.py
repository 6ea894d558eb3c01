"""What version 0.2 called otherwise still works, and says what to write instead."""

import json

import pytest

from raw2drive_ros.cli.main import main


@pytest.mark.parametrize(
    ('old', 'code', 'instead'),
    [
        (['sim', '--list'], 0, 'raw2drive scenario list'),
        (['sim', '--scenario', 'LaneFollowing', '--picture', 'PICTURE'], 0, 'raw2drive scenario show'),
        (
            ['evaluate', '--faults', 'PLANS', '--routes', 'LaneFollowing', '--seeds', '1'],
            0,
            'raw2drive evaluate faults',
        ),
        (['evaluate', '--faults', 'matrix', '--table'], 2, 'raw2drive evaluate faults'),
        (['evaluate', '--faults', 'matrix', '--seeds', '0'], 2, 'raw2drive evaluate faults --plans'),
        (['evaluate', '--driver', 'straight', '--seeds', '1', '--quirks'], 0, '--bench2drive-compat'),
        (['report', 'RESULTS', '--strips', '3', '--json'], 0, '--filmstrips'),
    ],
)
def test_an_old_spelling_works_and_warns(tmp_path, capsys, old, code, instead) -> None:
    results = tmp_path / 'straight.jsonl'
    if 'RESULTS' in old:
        assert main(['evaluate', '--driver', 'straight', '--seeds', '1', '--out', str(results)]) == 0
        assert 'warning' not in capsys.readouterr().err, 'the new spelling does not warn'
    plans = tmp_path / 'plans.yaml'
    plans.write_text('plans: {odometry lost: [{topic: /vehicle/odometry, kind: drop}]}\n')
    places = {'PICTURE': str(tmp_path / 'scene.png'), 'RESULTS': str(results), 'PLANS': str(plans)}
    assert main([places.get(word, word) for word in old]) == code
    warning = capsys.readouterr().err.splitlines()[0]
    assert warning.startswith('warning: ')
    assert instead in warning
    if 'PICTURE' in old:
        assert (tmp_path / 'scene.png').stat().st_size > 10_000


def test_the_flag_for_bench2drive_compat_is_read(tmp_path) -> None:
    for flags, stored in (([], False), (['--bench2drive-compat'], True), (['--quirks'], True)):
        target = tmp_path / f'{"".join(flags)}.jsonl'
        assert main(['evaluate', '--driver', 'straight', '--seeds', '1', '--out', str(target), *flags]) == 0
        assert json.loads(target.read_text().splitlines()[0])['bench2drive_compat'] is stored
