"""Bags to training arrays: one cache folder per bag and preset, rebuilt when either changes.

The trainer's only input is bags. The cache holds their content in the order and size in which batches are read
(memory-mapped, masks packed as bits).
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.artifact import whole_folder
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.driving.preprocessing import RouteProgress, raw_vector
from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import (
    camera_topics,
    open_bag,
    read_advice,
    read_calibrations,
    read_ticks,
    require_topics,
)
from raw2drive_ros.tables.vector_layout import EGO_SIZE, VECTOR_SIZE
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.mask_codec import MaskCodec

CACHE_VERSION = 5
ARRAYS = ('masks', 'ego', 'vector', 'action', 'advice', 'reward', 'flags')
FIRST, TERMINAL, LAST = 1, 2, 4
# In bags of this driver that hold no advice, its actions are taken as the advice.
DEMONSTRATOR = 'expert'


@dataclass(slots=True)
class BagArrays:
    """The N ticks of one bag.

    masks: (N, packed_bytes) uint8, see `MaskCodec`. ego: (N, 5). vector: (N, V). action: (N,) int64, which LED to the
    tick, -1 at the first tick of an episode. advice: (N,) int64, what the expert would do AT the tick, -1 where it was
    not asked. reward: (N,), for arriving at the tick. flags: (N,) bits FIRST, TERMINAL, LAST. images:
    (N, views, height, width, 3) uint8 or None. episodes: their names. driver: who drove, from the bag's provenance.
    """

    path: Path
    identity: str
    masks: NDArray[np.uint8]
    ego: NDArray[np.float32]
    vector: NDArray[np.float32]
    action: NDArray[np.int64]
    advice: NDArray[np.int64]
    reward: NDArray[np.float32]
    flags: NDArray[np.uint8]
    images: NDArray[np.uint8] | None
    episodes: list[str]
    driver: str = ''

    def __len__(self) -> int:
        return len(self.action)


def bag_identity(path: Path) -> str:
    """Hash of a bag's metadata and the sizes of its files: changes whenever the bag does."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        digest.update(f'{file.name}:{file.stat().st_size}'.encode())
        if file.name == 'metadata.yaml':
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def load_bag(path: Path, cache_root: Path, config: ModelConfig, *, cameras: bool) -> BagArrays:
    """The arrays of a bag, from the cache, which is built where it is missing. Raises BagError."""
    codec = MaskCodec(config)
    layout = json.dumps([config.mask_classes, config.mask_size, config.patch, cameras, CACHE_VERSION], sort_keys=True)
    identity = bag_identity(path)
    folder = cache_root / f'{identity}-{hashlib.sha256(layout.encode()).hexdigest()[:8]}'
    if not (folder / 'episodes.json').is_file():
        _build(path, folder, codec, cameras=cameras)
    arrays: dict[str, Any] = {name: np.load(folder / f'{name}.npy', mmap_mode='r') for name in ARRAYS}
    images = np.load(folder / 'images.npy', mmap_mode='r') if cameras else None
    episodes = json.loads((folder / 'episodes.json').read_text())
    small = {name: np.array(arrays[name]) for name in ARRAYS if name != 'masks'}
    driver = provenance_of(path).get('driver', '')
    return BagArrays(path, identity, arrays['masks'], **small, images=images, episodes=episodes, driver=driver)


def _build(path: Path, folder: Path, codec: MaskCodec, *, cameras: bool) -> None:
    purpose = 'training the raw stream' if cameras else 'training the privileged stream'
    wanted = [topics.BEV, topics.EGO, topics.TRANSITION, topics.IMU, topics.ODOMETRY, topics.ROUTE]
    with open_bag(path) as reader:
        if cameras:
            held = set(camera_topics(reader).values())
            wanted += [topics.image_topic(c) for c in topics.CAMERAS if c not in held]
        require_topics(reader, path, wanted, purpose)
        count = next(c.msgcount for c in reader.connections if c.topic == topics.TRANSITION)
        if folder.is_dir() and not (folder / 'episodes.json').is_file():
            # Somebody has taken files away: what is written whole has all of them.
            shutil.rmtree(folder)
        with whole_folder(folder, keep_existing=True) as partial:
            written, episodes = _fill(reader, path, partial, codec, count, cameras=cameras)
            if written == 0:
                raise BagError(f'{path}: holds no complete tick')
            (partial / 'episodes.json').write_text(json.dumps(episodes))


def _fill(
    reader: Any, path: Path, folder: Path, codec: MaskCodec, count: int, *, cameras: bool
) -> tuple[int, list[str]]:
    masks = np.zeros((count, codec.packed_bytes), np.uint8)
    ego = np.zeros((count, EGO_SIZE), np.float32)
    vector = np.zeros((count, VECTOR_SIZE), np.float32)
    action, advice = np.zeros(count, np.int64), np.full(count, -1, np.int64)
    try:
        advised = read_advice(reader, RosbagsFactory())
    except ContractError as error:
        raise BagError(f'{path}: {error}') from error
    reward = np.zeros(count, np.float32)
    flags = np.zeros(count, np.uint8)
    images: Any = None
    episodes: list[str] = []
    progress = RouteProgress()
    n = 0
    for tick in read_ticks(reader, path, cameras=cameras):
        assert tick.privileged is not None and tick.transition is not None
        step = tick.transition
        progress.update(tick.route, tick.odometry)
        masks[n], ego[n] = codec.pack(tick.privileged.bev), tick.privileged.ego
        vector[n] = raw_vector(tick.imu, tick.odometry, progress)
        action[n], reward[n] = step.action, step.reward
        advice[n] = advised.get(tick.stamp_ns, -1)
        flags[n] = FIRST * step.is_first + TERMINAL * step.is_terminal + LAST * step.is_last
        if step.is_first:
            episodes.append(tick.episode)
        if cameras:
            stack = np.stack([tick.images[c] for c in topics.CAMERAS])
            if images is None:
                images = np.lib.format.open_memmap(folder / 'images.npy', 'w+', np.uint8, (count, *stack.shape))
            images[n] = stack
        n += 1
    if cameras and images is not None:
        images.flush()
    if not advised and provenance_of(path).get('driver') == DEMONSTRATOR:
        same_episode = (flags[1:n] & FIRST) == 0
        advice[: n - 1][same_episode] = action[1:n][same_episode]
    arrays: tuple[NDArray[Any], ...] = (masks, ego, vector, action, advice, reward, flags)
    for name, value in zip(ARRAYS, arrays, strict=True):
        np.save(folder / f'{name}.npy', value[:n])
    return n, episodes


def load_bags(
    paths: list[Path],
    cache_root: Path,
    config: ModelConfig,
    *,
    cameras: bool,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[BagArrays]:
    """The arrays of all bags, in order; `progress(done, total)` is called after each. Raises BagError."""
    loaded = []
    for i, path in enumerate(paths):
        loaded.append(load_bag(path, cache_root, config, cameras=cameras))
        progress(i + 1, len(paths))
    return loaded


def rig_of(path: Path) -> tuple[CameraCalibration, ...]:
    """The camera calibrations recorded in a bag. Raises BagError when there are none."""
    with open_bag(path) as reader:
        rig = read_calibrations(reader, RosbagsFactory())
    if not rig:
        raise BagError(f'{path}: has no camera calibration')
    return rig
