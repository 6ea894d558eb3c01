import numpy as np
import pytest
import torch

from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.tables.vector_layout import FIRST_CHECKPOINT, VECTOR_SIZE
from raw2drive_ros.training.config import make_config
from raw2drive_ros.world_model.camera_encoder import (
    CameraEncoder,
    Lifting,
    Navigation,
    cell_centres_m,
    lifting_entries,
)

CONFIG = make_config('nano').model


def test_cell_centres_have_the_ego_below_the_middle() -> None:
    cells = cell_centres_m(16)
    assert cells[0, 0] == pytest.approx((44.8 - 2.0, 30.0))
    assert cells[-1, -1] == pytest.approx((-19.2 + 2.0, -30.0))


def test_lifting_samples_the_pixel_that_calibration_names() -> None:
    """Paint each feature pixel with its own coordinates; the lifted value must be the projected position."""
    rig = camera_rig()
    front = rig[:1]
    rows, columns, weights = lifting_entries(front, 32, 0.0)
    width = front[0].width // 8
    u_of, v_of = columns % width, columns // width
    sums_u, sums_v, total = np.zeros(1024), np.zeros(1024), np.zeros(1024)
    np.add.at(sums_u, rows, weights * u_of)
    np.add.at(sums_v, rows, weights * v_of)
    np.add.at(total, rows, weights)
    cell = next(i for i in range(1024) if total[i] > 0.99 and abs(sums_v[i] - round(sums_v[i])) > 0.05)
    x, y = cell_centres_m(32).reshape(-1, 2)[cell]
    focal = front[0].intrinsics[0, 0]
    u = (80.0 - focal * y / (x - 0.8)) / 8 - 0.5
    v = (48.0 + focal * 1.6 / (x - 0.8)) / 8 - 0.5
    assert sums_u[cell] == pytest.approx(u, abs=1e-6)
    assert sums_v[cell] == pytest.approx(v, abs=1e-6)


def test_nothing_behind_a_camera_is_lifted() -> None:
    rows, _, _ = lifting_entries(camera_rig()[:1], 32, 1.0)
    x = cell_centres_m(32).reshape(-1, 2)[np.unique(rows), 0]
    assert x.min() > 0.8


def test_sparse_lifting_has_the_gradient_of_its_dense_form() -> None:
    torch.manual_seed(0)
    lift = Lifting(CONFIG, camera_rig())
    pixels = 6 * 12 * 20
    features = torch.randn(1, pixels, 2, dtype=torch.float32, requires_grad=True)
    scores = torch.randn(1, pixels, len(CONFIG.lift_heights_m), requires_grad=True)
    out = lift(features, scores)
    weight = torch.randn_like(out)
    (out * weight).sum().backward()
    got = features.grad.clone(), scores.grad.clone()
    features.grad = scores.grad = None
    parts = []
    for i, matrix in enumerate(lift.matrices):
        dense = matrix.to_dense()
        w = torch.exp(scores[0, :, i : i + 1].clamp(-6, 6))
        parts.append(((dense @ (features[0] * w)) / (dense @ w + 1e-3)).T.reshape(1, 2, 16, 16))
    (torch.cat(parts, 1) * weight).sum().backward()
    assert torch.allclose(got[0], features.grad, atol=1e-4)
    assert torch.allclose(got[1], scores.grad, atol=1e-4)


def test_navigation_is_drawn_where_the_checkpoints_are() -> None:
    vector = torch.zeros(1, VECTOR_SIZE)
    vector[0, FIRST_CHECKPOINT:] = torch.tensor([20.0, 0.0, 20.0, 25.0, 20.0, 25.0]) / 25.0
    line, points = Navigation(32)(vector)[0]
    cells = torch.from_numpy(cell_centres_m(32))
    near_turn = (cells - torch.tensor([20.0, 12.0])).square().sum(-1).argmin()
    far_right = (cells - torch.tensor([20.0, -12.0])).square().sum(-1).argmin()
    assert float(line.flatten()[near_turn]) > 0.7
    assert float(line.flatten()[far_right]) < 0.01
    peak = cells.flatten(0, 1)[int(points.flatten().argmax())]
    assert min(torch.dist(peak, torch.tensor(p).double()) for p in ([20.0, 0.0], [20.0, 25.0])) < 1.5


def test_any_calibrated_rig_works_and_a_wrong_size_is_refused() -> None:
    encoder = CameraEncoder(CONFIG, camera_rig()[:4])
    out = encoder(torch.zeros(2, 4, 96, 160, 3, dtype=torch.uint8), torch.zeros(2, VECTOR_SIZE))
    assert out.shape == (2, CONFIG.grid_features, CONFIG.grid, CONFIG.grid)
    with pytest.raises(ValueError, match='expects 96x160'):
        CameraEncoder(CONFIG, camera_rig(224, 400))
