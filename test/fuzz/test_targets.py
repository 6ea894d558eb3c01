"""Each target on its seeds and on some random damage; `run.py` searches for longer, guided by coverage."""

import random

import pytest
import run
from targets import TARGETS

MUTATIONS = 100


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Bytes changed, removed, duplicated or inserted, or the end cut off."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, size = rng.randrange(len(changed) + 1), rng.choice((1, 2, 4, 8, 40))
        match rng.randrange(5):
            case 0:
                changed[at : at + size] = rng.randbytes(size)
            case 1:
                del changed[at : at + size]
            case 2:
                changed[at:at] = changed[at : at + size]
            case 3:
                changed[at : at + size] = rng.choice((b'\xff', b'\x00', b'[', b'-', b'nan', b'1e999')) * rng.choice(
                    (1, 4)
                )
            case _:
                changed = changed[: at + 1] if rng.random() < 0.3 else changed
    return bytes(changed)


@pytest.mark.parametrize('name', TARGETS)
def test_damage_is_an_error_that_we_meant(name) -> None:
    target, rng = TARGETS[name], random.Random(name)
    seeds = target.seeds()
    for seed in (*seeds, b''):
        target(seed)
    for _ in range(MUTATIONS):
        target(mutated(rng.choice(seeds), rng))


def test_every_target_can_be_chosen() -> None:
    assert tuple(TARGETS) == run.NAMES
