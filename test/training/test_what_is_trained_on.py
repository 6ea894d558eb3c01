"""Training says in one line what it trains on and what not."""

from dataclasses import replace

import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import Losses, data_line, load_bag
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.training.run import train
from raw2drive_ros.world_model.mask_codec import MaskCodec

MODEL = make_config('nano').model


def test_a_run_says_what_it_trains_on(bags, workspace, tmp_path, capsys) -> None:
    train('privileged', tmp_path / 'run', [bags], workspace / 'cache', 1, 'nano', {'threads': 1})
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith('data: ')]
    assert len(lines) == 1
    assert lines[0].startswith('data: bags 1, ticks ') and lines[0].endswith(', nothing left out')


def test_the_line_counts_what_is_left_out(bag, workspace) -> None:
    whole = load_bag(bag, workspace / 'cache', MODEL, cameras=False)
    losses = Losses(incomplete=2, missing=1, cuts=2, ends_lost=1, refused={topics.IMU: 2})
    line = data_line([whole, replace(whole, losses=losses)], [bag], 999)
    assert line == (
        f'data: bags 2, ticks {2 * len(whole)}, ticks dropped 3 (2 incomplete), messages refused 2 ({topics.IMU} 2), '
        'sequences cut 2, last or terminal ones lost 1, bags left out with fewer than 999 ticks 1'
    )


def test_bags_without_one_whole_sequence_are_one_clear_error(bag, workspace) -> None:
    whole = load_bag(bag, workspace / 'cache', MODEL, cameras=False)
    with pytest.raises(BagError, match=f'no bag holds {len(whole) + 1} ticks'):
        Replay([whole], MaskCodec(MODEL), len(whole) + 1, 0.0, 0)
