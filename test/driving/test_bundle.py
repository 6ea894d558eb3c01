import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from raw2drive_ros.contracts.errors import BundleError, ContractError, NonFiniteError
from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route, SensorFrame
from raw2drive_ros.driving.bundle import check_rig, load_bundle, save_bundle
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.simulation.camera_rig import camera_rig


def test_bundle_round_trip_has_weights_config_rig_and_card(bundle) -> None:
    loaded = load_bundle(bundle)
    assert loaded.config.deter == 64
    assert [c.name for c in loaded.rig] == [c.name for c in camera_rig()]
    assert loaded.identity in (bundle / 'MODEL_CARD.md').read_text()
    assert {p.name for p in bundle.iterdir()} == {'bundle.json', 'weights.safetensors', 'MODEL_CARD.md'}


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda p: (p / 'bundle.json').unlink(), 'no policy bundle there'),
        (lambda p: (p / 'bundle.json').write_text('{'), 'damaged bundle'),
        (lambda p: edit(p, 'action_table', 'x'), 'action_table hash'),
        (lambda p: edit(p, 'preprocessing', 'x'), 'preprocessing hash'),
        (lambda p: edit(p, 'format', 99), 'format 99'),
        (lambda p: edit(p, 'rig', []), 'does not match its identity'),
        (lambda p: flip(p / 'weights.safetensors'), 'do not match their hash'),
    ],
)
def test_a_damaged_or_foreign_bundle_is_refused(bundle, tmp_path, change, message) -> None:
    copy = tmp_path / 'bundle'
    shutil.copytree(bundle, copy)
    change(copy)
    with pytest.raises(BundleError, match=message):
        load_bundle(copy)


def edit(path, key, value) -> None:
    body = json.loads((path / 'bundle.json').read_text())
    body[key] = value
    (path / 'bundle.json').write_text(json.dumps(body))


def flip(file) -> None:
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(bytes(data))


@pytest.mark.parametrize('value', [float('nan'), float('inf'), float('-inf')])
@pytest.mark.parametrize('part', ['model', 'actor'])
def test_weights_that_are_not_finite_are_refused_at_load_and_at_export(bundle, tmp_path, part, value) -> None:
    """All hashes are right: whoever writes NaN into a bundle can write the hashes of that."""
    loaded = load_bundle(bundle)
    weight = next(iter(getattr(loaded, part).parameters()))
    with torch.no_grad():
        weight.view(-1)[0] = value
    arguments = loaded.config, loaded.rig, loaded.model, loaded.actor, {}
    with pytest.raises(NonFiniteError, match=f'{part}/.* not finite'):
        save_bundle(tmp_path / 'refused', *arguments)
    assert not (tmp_path / 'refused').exists()
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr('raw2drive_ros.artifact.not_finite', lambda tensors: '')
        save_bundle(tmp_path / 'bundle', *arguments)
    with pytest.raises(BundleError, match=f'{part}/.* holds weights that are not finite'):
        load_bundle(tmp_path / 'bundle')


def test_weights_beyond_half_precision_are_not_exported(bundle, tmp_path) -> None:
    """As float16 they would be infinite."""
    loaded = load_bundle(bundle)
    with torch.no_grad():
        next(iter(loaded.actor.parameters())).view(-1)[0] = 70_000.0
    with pytest.raises(NonFiniteError, match='not finite as float16'):
        save_bundle(tmp_path / 'bundle', loaded.config, loaded.rig, loaded.model, loaded.actor, {})


@pytest.mark.parametrize('value', [float('nan'), float('inf'), float('-inf')])
def test_nothing_is_proposed_from_logits_that_are_not_finite(bundle, value) -> None:
    driver = RawDriver(load_bundle(bundle))
    route = Route(0, np.array([[0.0, 0.0], [25.0, 0.0]]))
    driver.drive(frame_of(96, 160), route)
    before = driver.state
    bias = next(p for name, p in driver.agent.actor.named_parameters() if name.endswith('bias') and p.shape == (39,))
    good = bias.clone()
    bias.fill_(value)
    with pytest.raises(ContractError, match='not finite'):
        driver.drive(replace(frame_of(96, 160), stamp_ns=100_000_000), route)
    assert driver.state is before, 'the state from before is kept'
    bias.copy_(good)
    assert driver.drive(replace(frame_of(96, 160), stamp_ns=200_000_000), route).action >= 0


def test_every_difference_between_rigs_is_named(bundle) -> None:
    loaded = load_bundle(bundle)
    check_rig(loaded, camera_rig())
    with pytest.raises(BundleError, match='224x400, the bundle needs 96x160'):
        check_rig(loaded, camera_rig(224, 400))
    with pytest.raises(BundleError, match='camera back is missing'):
        check_rig(loaded, tuple(c for c in camera_rig() if c.name != 'back'))


def frame_of(height: int, width: int, cameras: int = 6) -> SensorFrame:
    images = {c.name: np.zeros((height, width, 3), np.uint8) for c in camera_rig()[:cameras]}
    return SensorFrame(0, images, ImuSample(0, (0, 0, 9.81), (0, 0, 0)), OdometrySample(0, 0, 0, 0, 0, 0))


def test_wrong_image_size_or_missing_camera_is_refused(bundle) -> None:
    driver = RawDriver(load_bundle(bundle))
    route = Route(0, np.array([[0.0, 0.0], [25.0, 0.0]]))
    with pytest.raises(ContractError, match='bundle needs 96x160'):
        driver.drive(frame_of(64, 96), route)
    with pytest.raises(ContractError, match='camera back_left is missing'):
        driver.drive(frame_of(96, 160, 4), route)
