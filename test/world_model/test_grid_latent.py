"""Grid latent: a cell's categoricals depend on that cell's features alone, and the decoder reads them at that cell."""

import pytest
import torch
from pydantic import ValidationError

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.tables.vector_layout import EGO_SIZE
from raw2drive_ros.training.config import make_config
from raw2drive_ros.world_model.bev_encoder import BevDecoder
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.distributions import FEW_CLASSES, mixed_log_probs
from raw2drive_ros.world_model.rssm import Rssm

NANO = make_config('nano').model.model_dump()
CONFIG = ModelConfig(**NANO | {'latent': 'grid', 'stoch': 32, 'classes': 4, 'depthwise': True})
CELLS = CONFIG.grid**2
EMBED = CONFIG.grid_features * CELLS + CONFIG.vector_features


@pytest.fixture
def rssm() -> Rssm:
    torch.manual_seed(0)
    return Rssm(CONFIG, EMBED, ACTION_COUNT)


def test_a_cell_s_features_decide_on_its_own_categoricals_only(rssm) -> None:
    embed = torch.randn(1, EMBED)
    other = embed.clone()
    cell = 5
    other[:, cell : CONFIG.grid_features * CELLS : CELLS] += 1.0
    deter = torch.randn(1, CONFIG.deter)
    before, after = (rssm.posterior(deter, rssm.post_embed(e)) for e in (embed, other))
    assert before.shape == (1, CONFIG.stoch, CONFIG.classes)
    changed = (before - after).abs().amax(-1)[0] > 1e-6
    per_cell = CONFIG.stoch // CELLS
    assert changed.nonzero().flatten().tolist() == list(range(cell * per_cell, (cell + 1) * per_cell))


def test_the_vector_reaches_every_cell(rssm) -> None:
    embed = torch.randn(1, EMBED)
    other = embed.clone()
    other[:, CONFIG.grid_features * CELLS :] += 1.0
    deter = torch.randn(1, CONFIG.deter)
    before, after = (rssm.posterior(deter, rssm.post_embed(e)) for e in (embed, other))
    assert bool(((before - after).abs().amax(-1) > 1e-6).all())


def test_the_decoder_reads_a_cell_s_categoricals_around_that_cell() -> None:
    torch.manual_seed(0)
    decoder = BevDecoder(CONFIG, EGO_SIZE)
    feature = torch.randn(1, CONFIG.feature_size)
    other = feature.clone()
    row, column = 0, 3
    per_cell = CONFIG.stoch_size // CELLS
    start = CONFIG.deter + (row * CONFIG.grid + column) * per_cell
    other[:, start : start + per_cell] += 1.0
    changed = ((decoder(feature) - decoder(other)).abs().amax(1)[0] > 1e-6).nonzero().tolist()
    near = [
        [r, c] for r in range(CONFIG.grid) for c in range(CONFIG.grid) if abs(r - row) <= 1 and abs(c - column) <= 1
    ]
    assert [row, column] in changed
    assert all(place in near for place in changed), 'one 3x3 convolution reaches one cell further'


def test_groups_that_do_not_divide_among_the_cells_are_refused() -> None:
    with pytest.raises(ValidationError, match='not a multiple of the 16 cells'):
        ModelConfig(**NANO | {'latent': 'grid', 'stoch': 24})


def test_both_ways_to_the_softmax_agree() -> None:
    logits = torch.randn(5, 7, FEW_CLASSES)
    few = mixed_log_probs(logits, 0.01)
    reference = torch.log(torch.softmax(logits, -1) * 0.99 + 0.01 / FEW_CLASSES)
    assert torch.allclose(few, reference, atol=1e-6)
