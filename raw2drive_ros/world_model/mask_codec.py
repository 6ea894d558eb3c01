"""The paper's 43 masks to those of a preset: merge channels, downsample, space-to-depth, pack to bits."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.tables.bev_channels import CHANNELS, SIZE_PX
from raw2drive_ros.world_model.config import ModelConfig


class MaskCodec:
    """Packs (43, 128, 128) masks for the cache and unpacks batches for the encoder."""

    def __init__(self, config: ModelConfig) -> None:
        self.groups = [[CHANNELS.index(name) for name in names] for names in config.mask_classes.values()]
        self.size, self.patch, self.grid = config.mask_size, config.patch, config.grid
        if SIZE_PX % config.mask_size or config.mask_size % config.patch:
            raise ValueError(f'mask_size {config.mask_size} must divide {SIZE_PX} and be a multiple of patch')

    @property
    def channels(self) -> int:
        return len(self.groups) * self.patch**2

    @property
    def packed_bytes(self) -> int:
        return self.channels * self.grid**2 // 8

    def merge(self, bev: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """(43, 128, 128) -> (C, mask_size, mask_size) 0/1: do the merged channels cover at least half of the pixel?"""
        merged = np.stack([bev[g[0]] if len(g) == 1 else bev[g].any(axis=0) for g in self.groups]).view(np.uint8)
        if self.size == SIZE_PX:
            return merged
        side = (self.size, self.size)
        small = [cv2.resize(m * np.uint8(255), side, interpolation=cv2.INTER_AREA) for m in merged]
        return (np.stack(small) >= 127).astype(np.uint8)

    def pack(self, bev: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """(43, 128, 128) -> (packed_bytes,) uint8: bits, cell by cell, each with its C*P*P space-to-depth channels."""
        masks = self.merge(bev)
        g, p = self.grid, self.patch
        deep = masks.reshape(len(masks), g, p, g, p).transpose(1, 3, 0, 2, 4)
        return np.packbits(deep.reshape(-1))

    def unpack(self, packed: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(N, packed_bytes) -> (N, C*P*P, G, G) 0/1, channels last in memory, where convolutions are faster."""
        bits = np.unpackbits(packed, axis=1)
        return bits.reshape(len(packed), self.grid, self.grid, self.channels).transpose(0, 3, 1, 2)

    def to_image_order(self, deep: NDArray[np.float32]) -> NDArray[np.float32]:
        """(N, C*P*P, G, G) -> (N, C, mask_size, mask_size), for pictures."""
        g, p = self.grid, self.patch
        split = deep.reshape(len(deep), len(self.groups), p, p, g, g)
        return split.transpose(0, 1, 4, 2, 5, 3).reshape(len(deep), len(self.groups), self.size, self.size)
