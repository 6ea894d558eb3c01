"""Calibration tells a good predictor from a bad one, and compares every state with what followed it."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
import torch

import raw2drive_ros.report.calibration as calibration
from raw2drive_ros.cli.main import main
from raw2drive_ros.report.calibration import (
    HORIZONS,
    CalibrationProbe,
    agreement,
    deciles,
    ended_within,
    horizon_steps,
    numbers,
    realised_returns,
    reliability,
)
from raw2drive_ros.training.dataset import FIRST, LAST, TERMINAL, load_bag
from raw2drive_ros.world_model.teacher import load_teacher


@pytest.fixture
def teacher(teacher_run):
    return load_teacher(teacher_run)


@pytest.fixture
def arrays(bag, workspace, teacher):
    return load_bag(bag, workspace / 'cache', teacher.config, cameras=False)


def with_flags(arrays, last):
    """Two episodes of 60 ticks; the first ends with `last`, the second is cut."""
    flags = np.zeros(len(arrays), np.uint8)
    flags[[0, 60]] = FIRST
    flags[59] |= last
    return dataclasses.replace(arrays, flags=flags)


def last_layer(net):
    return [module for module in net.modules() if hasattr(module, 'weight')][-1]


def test_a_calibrated_predictor_lies_on_the_diagonal_with_brier_p_times_1_minus_p() -> None:
    found = reliability(np.full(10, 0.3), np.arange(10) < 3)
    assert found['brier'] == pytest.approx(0.3 * 0.7) == pytest.approx(found['brier_of_rate'])
    assert [(b['states'], b['happened']) for b in found['bins']] == [(10, 0.3)]
    rng = np.random.default_rng(0)
    true = rng.uniform(size=200_000)
    happened = rng.uniform(size=len(true)) < true
    found = reliability(true, happened)
    assert found['brier'] == pytest.approx(np.mean(true * (1 - true)), abs=2e-3)
    assert sum(b['states'] for b in found['bins']) == len(true)
    assert all(b['happened'] == pytest.approx(b['predicted'], abs=0.02) for b in found['bins'])
    bold = reliability(np.clip(1.6 * (true - 0.5) + 0.5, 0, 1), happened)
    assert bold['brier'] > found['brier'] + 0.005
    assert bold['bins'][-1]['happened'] < bold['bins'][-1]['predicted'] - 0.05


def test_what_is_certain_falls_into_the_outermost_bins() -> None:
    found = reliability(np.array([0.0, 1.0]), np.array([False, True]))
    assert [(b['low'], b['high'], b['happened']) for b in found['bins']] == [(0.0, 0.01, 0.0), (0.9, 1.0, 1.0)]
    assert found['brier'] == 0.0


def test_the_return_of_a_hand_made_episode() -> None:
    rewards = np.array([0.0, 1.0, 2.0, -4.0])
    assert realised_returns(rewards, 0.5, 0.0).tolist() == [1.0, 0.0, -4.0, 0.0]
    assert realised_returns(rewards, 0.5, 8.0).tolist() == [2.0, 2.0, 0.0, 8.0]


def test_an_end_is_seen_from_so_many_steps_before_and_unknown_where_the_recording_stops() -> None:
    ended, known = ended_within(5, 2, terminal=True)
    assert ended[:-1].tolist() == [False, False, True, True]
    assert known.tolist() == [True, True, True, True, False]
    ended, known = ended_within(5, 2, terminal=False)
    assert not ended.any()
    assert known.tolist() == [True, True, True, False, False]


def test_agreement_and_deciles_by_hand() -> None:
    true = np.arange(20.0)
    assert agreement(true, true)['r2'] == 1.0
    found = agreement(0.5 * true + 1.0, true)
    assert found['correlation'] == pytest.approx(1.0) and found['bias'] == pytest.approx(1.0 - 0.5 * 9.5)
    assert found['r2'] == pytest.approx(1.0 - np.mean((1.0 - 0.5 * true) ** 2) / true.var())
    parts = deciles(-true, true)
    assert [part['states'] for part in parts] == [2] * 10
    assert (parts[0]['low'], parts[0]['high'], parts[0]['error']) == (-19.0, -18.0, -37.0)
    nothing = agreement(true[:0], true[:0])
    assert nothing['states'] == 0 and nothing['bias'] is None and nothing['r2'] is None


def test_steps_compound_and_a_model_that_sees_every_end_coming_is_wrong_by_the_rate(teacher, arrays) -> None:
    last = last_layer(teacher.model.cont.net)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.fill_(torch.logit(torch.tensor(0.9)))
    traces = list(CalibrationProbe(teacher).traces(with_flags(arrays, TERMINAL | LAST)))
    for i, steps in enumerate(HORIZONS):
        assert np.allclose(traces[0].ending[:, i], 1.0 - 0.9**steps, atol=1e-6)
    with torch.no_grad():
        last.bias.fill_(-40.0)
    found = numbers(list(CalibrationProbe(teacher).traces(with_flags(arrays, TERMINAL | LAST))), 0.98)
    for steps in HORIZONS:
        row = found['continue'][str(steps)]
        # All ticks of the first episode but its last one, and all of the second but the last `steps`.
        assert (row['states'], row['left_out']) == (59 + 60 - steps, 1 + steps)
        assert row['happened'] == pytest.approx(steps / row['states'])
        assert row['brier'] == pytest.approx(1.0 - row['happened'])


def test_imagination_takes_the_recorded_actions_that_follow(teacher, arrays) -> None:
    other = arrays.action.copy()
    other[40] = (other[40] + 1) % 39
    before = next(CalibrationProbe(teacher).traces(arrays))
    after = next(CalibrationProbe(teacher).traces(dataclasses.replace(arrays, action=other)))
    changed = before.ending != after.ending
    for i, steps in enumerate(HORIZONS):
        assert not changed[: 40 - steps, i].any(), 'the window ends before that action'
        assert changed[40 - steps : 40, i].any()
    assert changed[39, 0], 'that action leads from tick 39 to tick 40'
    assert (before.reward[:40] == after.reward[:40]).all() and before.reward[40] != after.reward[40]


def test_the_value_is_compared_with_the_rest_of_its_own_episode(teacher, arrays) -> None:
    gamma, horizon = teacher.gamma, horizon_steps(teacher.gamma)
    assert (gamma, horizon) == (0.98, 50)
    # After ten steps the critic says 0; here it expects something.
    with torch.no_grad():
        last_layer(teacher.policy.critic.fast.net).bias[25] = 10.0
    ended, cut = CalibrationProbe(teacher).traces(with_flags(arrays, TERMINAL | LAST))
    assert ended.value_known.tolist() == [True] * 59 + [False]
    assert ended.returned[57] == pytest.approx(arrays.reward[58] + gamma * arrays.reward[59])
    assert cut.value_known.tolist() == [True] * 10 + [False] * 50
    assert cut.value[-1] > 10.0
    rest = sum(gamma**i * float(r) for i, r in enumerate(arrays.reward[65:120]))
    assert cut.returned[4] == pytest.approx(rest + gamma**55 * cut.value[-1])
    stopped, _ = CalibrationProbe(teacher).traces(with_flags(arrays, LAST))
    assert stopped.value_known.sum() == 10, 'a driven route is no failure: the model expects it to go on'
    found = numbers([ended, cut], gamma)
    assert found['episodes'] == {'terminal': 1, 'last': 0, 'cut': 1}
    assert [found['value'][name]['states'] for name in ('all', 'terminal', 'last', 'cut')] == [69, 59, 0, 10]
    assert found['reward']['states'] == 118, 'nothing was earned by arriving at a first tick'
    assert found['reward']['true'] == pytest.approx(np.delete(arrays.reward, [0, 60]).mean())


def test_a_sequence_in_pieces_is_the_sequence(teacher, arrays, monkeypatch) -> None:
    whole = list(CalibrationProbe(teacher).traces(arrays))
    monkeypatch.setattr(calibration, 'CHUNK', 7)
    pieces = list(CalibrationProbe(teacher, samples=1).traces(arrays))
    for a, b in zip(whole, pieces, strict=True):
        assert np.allclose(a.reward, b.reward, atol=1e-5) and np.allclose(a.value, b.value, atol=1e-5)
        assert len(a.reward) == len(b.ending) == 60


def test_the_command_repeats_itself_and_draws(teacher_run, bags, workspace, tmp_path, capsys) -> None:
    def no_constant(name):
        raise AssertionError(f'{name} is not JSON')

    target = tmp_path / 'calibration.png'
    arguments = ['calibration', '--run', str(teacher_run), '--bags', str(bags), '--out', str(target)]
    arguments += ['--cache', str(workspace / 'cache')]
    found = []
    for _ in range(2):
        assert main([*arguments, '--json']) == 0
        found.append(json.loads(capsys.readouterr().out, parse_constant=no_constant))
    assert found[0] == found[1]
    assert (found[0]['bags'], found[0]['bags_learnt_from'], found[0]['drivers']) == (1, 1, {'rule': 1})
    assert found[0]['steps'] == 10 and found[0]['ticks'] == 120
    assert 0.0 <= found[0]['continue']['10']['brier'] <= 1.0
    assert cv2.imread(str(target)).std() > 10
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert 'Brier' in out and 'trained on' in out and str(target) in out.replace('\n', '')


def test_the_command_says_what_is_wrong(teacher_run, bags, tmp_path, capsys) -> None:
    good = ['calibration', '--run', str(teacher_run), '--bags', str(bags)]
    assert main([*good, '--out', 'x.gif']) == 2
    assert main([*good, '--samples', '0']) == 2
    assert main([*good, '--bags', str(tmp_path)]) == 1
    assert main(['calibration', '--run', str(tmp_path), '--bags', str(bags)]) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 4 and 'no bags found' in errors[2] and 'not a training run' in errors[3]
