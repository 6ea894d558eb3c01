"""The curves show what the run logged, without what a kill lost; the heat map shows the validations."""

import json
import shutil

import cv2
import numpy as np
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.report.charts import PALETTE
from raw2drive_ros.report.curves import draw, panels_of, read_run, read_runs
from raw2drive_ros.training.run import RunFolder


@pytest.fixture
def run(teacher_run, tmp_path):
    """A copy that a test may write to."""
    target = tmp_path / 'first' / 'stage1'
    target.mkdir(parents=True)
    shutil.copy(teacher_run / 'metrics.jsonl', target)
    return target


def axes_of(figure) -> dict:
    return {axis.get_title(): axis for axis in figure.axes}


def test_every_number_of_the_run_is_there(run) -> None:
    logged = [json.loads(line) for line in (run / 'metrics.jsonl').read_text().splitlines()]
    assert [line['step'] for line in logged] == [5, 10]
    RunFolder(run).log(10, {'validation/driving_score': 61.5, 'validation/success_percent': 40.0})
    metrics = read_run(run).metrics
    for name in set(logged[0]) - {'step', 'time'}:
        assert metrics[name][0].tolist() == [5, 10]
        assert metrics[name][1].tolist() == [line[name] for line in logged]
    assert [values.tolist() for values in metrics['validation/driving_score']] == [[10], [61.5]]
    assert not {'step', 'time'} & set(metrics)
    axes = axes_of(draw([read_run(run)]))
    assert axes['loss: masks'].lines[0].get_ydata().tolist() == [line['loss/masks'] for line in logged]
    assert axes['validation: driving score'].lines[0].get_ydata().tolist() == [61.5]
    assert axes['overlap: road'].lines[0].get_ydata().tolist() == [logged[-1]['iou/road']]


def test_a_metric_that_a_run_lacks_is_left_out_of_that_run_only(run, tmp_path) -> None:
    other = tmp_path / 'second' / 'plain'
    other.mkdir(parents=True)
    RunFolder(other).log(5, {'loss/masks': 3.0, 'loss/advice': 1.0, 'iou/road': 0.9, 'iou_dream/road': 0.4})
    first, second = read_runs([run, other])
    titles = [panel.title for panel in panels_of([first, second])]
    assert titles.index('loss: masks') < titles.index('loss: dyn') < titles.index('loss: advice')
    assert not any('imitation' in title or 'validation' in title for title in titles)
    figure = draw([first, second])
    axes = axes_of(figure)
    assert [line.get_color() for line in axes['loss: masks'].lines] == list(PALETTE[:2])
    assert [line.get_color() for line in axes['loss: dyn'].lines] == [PALETTE[0]]
    assert [line.get_color() for line in axes['loss: advice'].lines] == [PALETTE[1]]
    drawn = [(line.get_linestyle(), line.get_color()) for line in axes['overlap: road'].lines]
    assert drawn == [('-', PALETTE[0]), ('-', PALETTE[1]), ('--', PALETTE[1])]
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ['stage1', 'plain']


def test_runs_of_one_name_are_told_apart_by_the_folder_above(run, tmp_path) -> None:
    other = tmp_path / 'second' / 'stage1'
    shutil.copytree(run, other)
    assert [found.name for found in read_runs([run, other])] == ['first/stage1', 'second/stage1']


def test_what_a_run_that_began_anew_had_logged_before_is_dropped(tmp_path) -> None:
    folder = RunFolder(tmp_path)
    for step, value in ((50, 9.0), (100, 8.0), (150, 7.0), (50, 6.0), (100, 5.0)):
        folder.log(step, {'loss/masks': value} | ({'iou/road': 0.5} if value == 7.0 else {}))
    metrics = read_run(folder.path).metrics
    assert [values.tolist() for values in metrics['loss/masks']] == [[50, 100], [6.0, 5.0]]
    assert 'iou/road' not in metrics


def test_a_run_that_is_writing_can_be_read_and_a_damaged_one_is_named(run) -> None:
    with (run / 'metrics.jsonl').open('a') as file:
        file.write('{"step": 15, "loss/ma')
    assert read_run(run).metrics['loss/masks'][0].tolist() == [5, 10]
    with (run / 'metrics.jsonl').open('a') as file:
        file.write('\n{"step": 20}\n')
    with pytest.raises(CheckpointError, match='line 3 holds no metrics'):
        read_run(run)


def test_the_heat_map_is_the_share_of_successes_of_the_drives_that_are_done(run, tmp_path, capsys) -> None:
    results = run / 'validation' / 'round_02.jsonl'
    arguments = ['evaluate', '--driver', 'straight', '--routes', 'LaneFollowing,Accident', '--seeds', '2']
    assert main([*arguments, '--out', str(results), '--json']) == 0
    header, *rows = results.read_text().splitlines()
    done = [json.loads(row) for row in rows]
    accident = [row['success'] for row in done if row['type'] == 'Accident']
    # A round that is being driven: one drive of the other type, and it succeeded.
    one = next(row for row in done if row['type'] == 'LaneFollowing') | {'success': True}
    (run / 'validation' / 'round_03.jsonl').write_text(f'{header}\n{json.dumps(one)}\n')
    (run / 'validation' / 'round_04.jsonl').write_text('')
    found = read_run(run)
    assert [one.title for one in found.rounds] == ['2', '3 (1 of 4)']
    axis = axes_of(draw([found]))['stage1: share of validation drives that succeed']
    assert [label.get_text() for label in axis.get_xticklabels()] == ['Accident', 'LaneFollowing']
    table = np.ma.filled(axis.images[0].get_array(), np.nan)
    assert table[0, 0] == np.mean(accident)
    assert np.isnan(table[1, 0]) and table[1, 1] == 1.0


def test_the_command_draws_a_picture_and_says_what_is_wrong(run, tmp_path, capsys) -> None:
    target = tmp_path / 'pictures' / 'curves.png'
    assert main(['curves', str(run), '--out', str(target)]) == 0
    assert 'stage1' in capsys.readouterr().out
    picture = cv2.imread(str(target))
    assert picture.std() > 10
    empty = tmp_path / 'empty'
    empty.mkdir()
    assert main(['curves', str(run), str(empty)]) == 1
    error = capsys.readouterr().err.strip()
    assert 'empty: not a training run' in error and len(error.splitlines()) == 1
    (empty / 'metrics.jsonl').write_text('')
    assert main(['curves', str(empty)]) == 1
    assert 'no metrics yet' in capsys.readouterr().err
    assert main(['curves', str(run), '--out', 'x.gif']) == 2
