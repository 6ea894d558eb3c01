"""Camera images to the grid of e_t: shared backbone, geometric lifting, BEV convolutions.

Lifting: every BEV cell centre at several heights is projected into every camera by calibration; the
bilinear weights form a sparse matrix (rows: height x cell, columns: feature pixels of all views),
built once per rig. Each feature pixel also predicts a score per height; the lifted value is the
score-weighted mean over all views that see the point, so the network learns which view and which
height to trust. Any calibrated pinhole rig works; only the matrix depends on it.

The route checkpoints are drawn onto the same grid, as Gaussians of the distance to the polyline through them.
As vector features alone they had no effect on the grid: aligning those features with the privileged ones
erased the route, and the car drove straight on at junctions (docs/lab_notes.md).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import CameraCalibration, Float64
from raw2drive_ros.tables.bev_channels import EGO_COLUMN_PX, EGO_ROW_PX, PIXELS_PER_M, SIZE_PX
from raw2drive_ros.tables.vector_layout import CHECKPOINT_SCALE_M, CHECKPOINTS_AHEAD, FIRST_CHECKPOINT
from raw2drive_ros.world_model.bev_encoder import Residual
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.layers import Conv

STRIDE = 8
NEAR_M = 0.2
NAVIGATION_WIDTH_M = 2.0


def cell_centres_m(side: int) -> Float64:
    """(side, side, 2) ego-frame (x, y) of the cells of a grid over the BEV window; row 0 is far ahead."""
    step = SIZE_PX / side
    rows = (np.arange(side) + 0.5) * step
    x = (EGO_ROW_PX - rows) / PIXELS_PER_M
    y = (EGO_COLUMN_PX - rows) / PIXELS_PER_M
    grid_x, grid_y = np.meshgrid(x, y, indexing='ij')
    return np.stack([grid_x, grid_y], axis=-1)


def lifting_entries(
    cameras: Sequence[CameraCalibration], side: int, height_m: float, stride: int = STRIDE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries (rows, columns, weights) of the bilinear sampling matrix of one height.

    height_m: z in `base_link`. rows: cell index in [0, side^2). columns: feature pixel of all cameras, camera-major.
    """
    xy = cell_centres_m(side).reshape(-1, 2)
    points = np.column_stack([xy, np.full(len(xy), height_m), np.ones(len(xy))])
    rows, columns, weights = [], [], []
    offset = 0
    for camera in cameras:
        feature_h, feature_w = camera.height // stride, camera.width // stride
        local = points @ np.linalg.inv(camera.base_from_camera).T
        depth = local[:, 2]
        pixel = local[:, :3] @ camera.intrinsics.T
        safe = np.maximum(depth, NEAR_M)
        u = pixel[:, 0] / safe / stride - 0.5
        v = pixel[:, 1] / safe / stride - 0.5
        seen = (depth > NEAR_M) & (u > -0.5) & (u < feature_w - 0.5) & (v > -0.5) & (v < feature_h - 0.5)
        cell = np.flatnonzero(seen)
        left, top = np.floor(u[cell]).astype(int), np.floor(v[cell]).astype(int)
        part_u, part_v = u[cell] - left, v[cell] - top
        for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
            column = np.clip(left + du, 0, feature_w - 1)
            row = np.clip(top + dv, 0, feature_h - 1)
            weight = (part_u if du else 1 - part_u) * (part_v if dv else 1 - part_v)
            rows.append(cell)
            columns.append(offset + row * feature_w + column)
            weights.append(weight)
        offset += feature_h * feature_w
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)


class _SparseLift(torch.autograd.Function):
    """matrix @ dense with a precomputed transpose for the backward pass."""

    @staticmethod
    def forward(ctx: Any, dense: Tensor, matrix: Tensor, transposed: Tensor) -> Tensor:
        ctx.transposed = transposed
        return matrix @ dense

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return ctx.transposed @ gradient.contiguous(), None, None


class Lifting(nn.Module):
    """Features (N, pixels, features) and scores (N, pixels, Z) of the feature pixels of all cameras, camera-major ->
    (N, Z*features, side, side): the score-weighted mean of all cameras, for each height."""

    def __init__(self, config: ModelConfig, cameras: Sequence[CameraCalibration]) -> None:
        super().__init__()
        self.side = config.lift_grid
        self.heights = config.lift_heights_m
        self.matrices: list[Tensor] = []
        self.transposed: list[Tensor] = []
        pixels = sum((c.height // STRIDE) * (c.width // STRIDE) for c in cameras)
        for height in self.heights:
            rows, columns, weights = lifting_entries(cameras, self.side, height)
            matrix = torch.sparse_coo_tensor(
                torch.from_numpy(np.stack([rows, columns])),
                torch.from_numpy(weights).float(),
                (self.side * self.side, pixels),
                check_invariants=False,
            ).coalesce()
            with warnings.catch_warnings():
                # Torch warns that CSR is in beta; only its matrix product is used here, and a test checks that.
                warnings.filterwarnings('ignore', message='Sparse CSR tensor support')
                self.matrices.append(matrix.to_sparse_csr())
                self.transposed.append(matrix.t().coalesce().to_sparse_csr())

    def forward(self, features: Tensor, scores: Tensor) -> Tensor:
        count, pixels, width = features.shape
        lifted = []
        for i in range(len(self.heights)):
            weight = torch.exp(scores[..., i : i + 1].clamp(-6.0, 6.0))
            stacked = torch.cat([features * weight, weight], -1)
            flat = stacked.permute(1, 0, 2).reshape(pixels, count * (width + 1))
            summed = _SparseLift.apply(flat, self.matrices[i], self.transposed[i])
            summed = summed.view(self.side, self.side, count, width + 1)
            mean = summed[..., :-1] / (summed[..., -1:] + 1e-3)
            lifted.append(mean.permute(2, 3, 0, 1))
        return torch.cat(lifted, 1)


class Navigation(nn.Module):
    """(N, V) vector -> (N, 2, side, side): how near a cell is to the polyline through the next checkpoints, and to the
    nearest checkpoint; Gaussians of the distance, 1 at distance 0."""

    cells: Tensor

    def __init__(self, side: int) -> None:
        super().__init__()
        cells = torch.from_numpy(cell_centres_m(side)).float().flatten(0, 1)
        self.register_buffer('cells', cells, persistent=False)
        self.side = side

    def forward(self, vector: Tensor) -> Tensor:
        flat = vector[:, FIRST_CHECKPOINT : FIRST_CHECKPOINT + 2 * CHECKPOINTS_AHEAD] * CHECKPOINT_SCALE_M
        points = flat.view(-1, CHECKPOINTS_AHEAD, 2)
        starts = torch.cat([torch.zeros_like(points[:, :1]), points[:, :-1]], 1)
        along = points - starts
        length = along.square().sum(-1).clamp(min=1e-6)
        # (N, segments, cells, 2), in metres: from the start of each segment to each cell.
        offset = self.cells[None, None] - starts[:, :, None]
        part = ((offset * along[:, :, None]).sum(-1) / length[..., None]).clamp(0.0, 1.0)
        to_line = (offset - part[..., None] * along[:, :, None]).square().sum(-1).amin(1)
        to_point = (self.cells[None, None] - points[:, :, None]).square().sum(-1).amin(1)
        near = torch.stack([to_line, to_point], 1) / (2.0 * NAVIGATION_WIDTH_M**2)
        return torch.exp(-near).view(-1, 2, self.side, self.side)


class CameraEncoder(nn.Module):
    """(N, views, height, width, 3) uint8 RGB and (N, V) vector -> ê_t (N, E, G, G).

    Raises ContractError for a camera whose image size is not the model's, ValueError for a `lift_grid` that strided
    convolutions cannot reduce to the grid.
    """

    def __init__(self, config: ModelConfig, cameras: Sequence[CameraCalibration]) -> None:
        super().__init__()
        c = config
        height, width = c.image_size
        for camera in cameras:
            if (camera.height, camera.width) != (height, width):
                raise ContractError(
                    f'camera {camera.name} is {camera.height}x{camera.width}, the model expects {height}x{width}'
                )
        w = c.camera_width
        narrow = max(8, w * 2 // 3)
        self.backbone = nn.Sequential(Conv(3, narrow, 8, 4), nn.SiLU(), Conv(narrow, w, 4, 2), nn.SiLU(), Residual(w))
        self.score = Conv(w, len(c.lift_heights_m), 1)
        self.lift = Lifting(config, cameras)
        self.navigation = Navigation(c.lift_grid)
        self.squeeze = Conv(len(c.lift_heights_m) * w + 2, c.encoder_width, 1)
        stages: list[nn.Module] = []
        side = c.lift_grid
        while side > c.grid:
            stages += [nn.SiLU(), Conv(c.encoder_width, c.encoder_width, 4, 2)]
            side //= 2
        if side != c.grid:
            raise ValueError(f'lift_grid {c.lift_grid} is not a power-of-two multiple of grid {c.grid}')
        self.reduce = nn.Sequential(*stages)
        self.body = Residual(c.encoder_width)
        self.out = Conv(c.encoder_width, c.grid_features, 1)

    def forward(self, images: Tensor, vector: Tensor) -> Tensor:
        count, views = images.shape[:2]
        # .float() keeps the memory order of the permuted view, channels last; -0.5 centres the input.
        pixels = images.flatten(0, 1).permute(0, 3, 1, 2).float() / 255.0 - 0.5
        x = self.backbone(pixels)
        scores = self.score(x).flatten(2).transpose(1, 2).reshape(count, -1, self.score.out_channels)
        features = x.flatten(2).transpose(1, 2).reshape(count, views * x.shape[2] * x.shape[3], -1)
        lifted = torch.cat([self.lift(features, scores), self.navigation(vector)], 1)
        grid = self.reduce(self.squeeze(lifted))
        return torch.tanh(self.out(nn.functional.silu(self.body(grid))))
