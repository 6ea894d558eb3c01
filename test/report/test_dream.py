"""The video of what a world model imagines: the right moment, the right episode, nothing imagined before it."""

import av
import numpy as np
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.report import dream as dream_module
from raw2drive_ros.report.dream import SIZE, Dream, dream, overlaps, save_dream, ticks_around
from raw2drive_ros.world_model.teacher import load_teacher


def test_imagination_begins_at_the_moment_and_filtering_goes_on(bag, teacher_run, tmp_path) -> None:
    ticks, begins = ticks_around(bag, 3.0, 1.0)
    assert (begins, len(ticks)) == (30, 41), 'ten ticks a second, all of one episode'
    teacher = load_teacher(teacher_run)
    found = dream(teacher, ticks, begins)
    assert np.isnan(found.reward['imagined'][begins - 1]) and np.isfinite(found.reward['imagined'][begins:]).all()
    assert np.isfinite(found.reward['posterior']).all()
    assert found.reward['truth'] == [tick.transition.reward for tick in ticks]
    target = save_dream(tmp_path / 'dream.mp4', found, list(teacher.config.mask_classes))
    with av.open(str(target)) as video:
        frames = [frame.to_ndarray(format='rgb24') for frame in video.decode(video=0)]
    assert len(frames) == 20 + 11
    assert frames[0].shape == (SIZE[1], SIZE[0], 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


def test_own_actions_lead_elsewhere_than_the_recorded_ones(bag, teacher_run) -> None:
    ticks, begins = ticks_around(bag, 3.0, 1.0)
    teacher = load_teacher(teacher_run)
    recorded, own = (dream(teacher, ticks, begins, own_actions=own) for own in (False, True))
    assert recorded.reward['posterior'] == own.reward['posterior']
    assert not np.array_equal(recorded.masks['imagined'][-1], own.masks['imagined'][-1])


def test_a_moment_after_the_end_or_in_the_last_tick_of_an_episode_is_a_clear_error(bag) -> None:
    for at_s in (500.0, 5.95):
        with pytest.raises(BagError, match='no episode goes on'):
            ticks_around(bag, at_s, 1.0)


def test_the_command_says_what_is_wrong(bag, teacher_run, capsys) -> None:
    assert main(['dream', str(bag), '--at', '-1', '--run', str(teacher_run)]) == 2
    assert main(['dream', str(bag), '--at', '1', '--run', str(teacher_run), '--out', 'x.gif']) == 2
    assert 'mp4' in capsys.readouterr().err


def test_the_overlap_with_the_truth_is_that_of_the_masks() -> None:
    def masks(*squares: int) -> list[np.ndarray]:
        return [np.repeat(np.arange(10) < count, 10).reshape(1, 10, 10).astype(np.float32) for count in squares]

    found = Dream(1, {'truth': masks(5, 5, 5, 0), 'posterior': masks(5, 5, 5, 0), 'imagined': masks(0, 5, 4, 5)})
    assert overlaps(found, 'imagined') == {0.0: 1.0, 0.1: 0.8, 0.2: 0.0}
    assert overlaps(found, 'posterior') == {0.0: 1.0, 0.1: 1.0, 0.2: 0.0}


def test_the_command_says_how_far_the_imagination_holds(bag, teacher_run, tmp_path, capsys, monkeypatch) -> None:
    words: list[str] = []
    draw = dream_module.text

    def noting(canvas, said, *more, **how) -> None:
        words.append(said)
        draw(canvas, said, *more, **how)

    monkeypatch.setattr(dream_module, 'text', noting)
    out = tmp_path / 'dream.mp4'
    assert main(['dream', str(bag), '--at', '3', '--seconds', '1', '--run', str(teacher_run), '--out', str(out)]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    ticks, begins = ticks_around(bag, 3.0, 1.0)
    found = dream(load_teacher(teacher_run), ticks, begins)
    imagined, posterior = (overlaps(found, name) for name in ('imagined', 'posterior'))
    parts = [f'{imagined[after]:.2f} (posterior {posterior[after]:.2f}) after {after:g} s' for after in (0.5, 1.0)]
    assert said == f'overlap of the imagined masks with the true ones: {", ".join(parts)}'
    assert f'imagined, overlap with truth {imagined[1.0]:.2f}' in words
    assert 'speed x0.5' in words
