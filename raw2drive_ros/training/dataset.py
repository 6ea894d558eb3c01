"""Bags to training arrays: one cache folder per bag and preset, rebuilt when either changes.

The trainer's only input is bags. The cache holds their content in the order and size in which batches are read
(memory-mapped, masks packed as bits).

**Sequences.** A bag is one row of ticks, and a window of training is any stretch of it. Where the row is broken
(`driving.continuity`: a tick is missing or incomplete, another episode, time that went back), the next tick is marked
as a FIRST one, so that a window may cross the place without learning from it: the recurrent state is zero there, and no
action led there (-1), as at the driver's first decision after a gap. The last tick before stays what it was, with its
own reward, and goes on (`cont` is 1) unless it was terminal itself. Short stretches stay usable, because a window may
hold several of them.

CUT marks those FIRST ticks that are not the first of their episode. Their reward stays as recorded: it is predicted
from the state in which the car arrives, like the reward of a window that begins in mid-episode, and with zero in its
place a crash right behind a gap would be a harmless place. What a lost tick itself was worth is lost with it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.artifact import whole_folder
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.privileged import Advice, PrivilegedFrame
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.driving.preprocessing import RouteProgress, raw_vector
from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import open_bag, read_calibrations, require_topics
from raw2drive_ros.recording.line_reader import time_lines
from raw2drive_ros.recording.ticks import BagTick, TickCounts, camera_topics, read_advice, read_ticks
from raw2drive_ros.tables.vector_layout import VECTOR_SIZE
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.privileged_inputs import extra_topics, masks_of, vector_of

CACHE_VERSION = 8
ARRAYS = ('masks', 'ego', 'vector', 'action', 'advice', 'reward', 'flags')
FIRST, TERMINAL, LAST, CUT = 1, 2, 4, 8
# In bags of this driver that hold no advice, its actions are taken as the advice.
DEMONSTRATOR = 'expert'


@dataclass(slots=True)
class Losses:
    """What was left out of a bag, see `recording.ticks.TickCounts`. refused: messages by topic."""

    incomplete: int = 0
    missing: int = 0
    cuts: int = 0
    begins_lost: int = 0
    ends_lost: int = 0
    back: int = 0
    refused: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, counts: TickCounts) -> Losses:
        return cls(
            counts.incomplete,
            counts.missing,
            counts.cuts,
            counts.begins_lost,
            counts.ends_lost,
            counts.back,
            dict(counts.verdicts.refused),
        )


@dataclass(slots=True)
class BagArrays:
    """The N ticks of one bag.

    masks: (N, packed_bytes) uint8, see `MaskCodec`. ego: (N, E), the `ego_fields` of the configuration. vector: (N, V).
    action: (N,) int64, which LED to the tick, -1 at the first tick of a sequence. advice: (N,) int64, what the expert
    would do AT the tick, -1 where it was not asked. reward: (N,), for arriving at the tick. flags: (N,) bits FIRST,
    TERMINAL, LAST, CUT. images: (N, views, height, width, 3) uint8 or None. episodes: their names. driver: who drove,
    from the bag's provenance. losses: what of the bag is not in the arrays.
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
    losses: Losses = field(default_factory=lambda: Losses())

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
    layout = json.dumps(_layout(config) | {'cameras': cameras, 'version': CACHE_VERSION}, sort_keys=True)
    identity = bag_identity(path)
    folder = cache_root / f'{identity}-{hashlib.sha256(layout.encode()).hexdigest()[:8]}'
    if not (folder / 'episodes.json').is_file():
        _build(path, folder, codec, config, cameras=cameras)
    arrays: dict[str, Any] = {name: np.load(folder / f'{name}.npy', mmap_mode='r') for name in ARRAYS}
    images = np.load(folder / 'images.npy', mmap_mode='r') if cameras else None
    episodes = json.loads((folder / 'episodes.json').read_text())
    small = {name: np.array(arrays[name]) for name in ARRAYS if name != 'masks'}
    driver = provenance_of(path).get('driver', '')
    losses = Losses(**json.loads((folder / 'losses.json').read_text()))
    return BagArrays(
        path, identity, arrays['masks'], **small, images=images, episodes=episodes, driver=driver, losses=losses
    )


def _layout(config: ModelConfig) -> dict[str, Any]:
    """What of a configuration decides on the content of the arrays."""
    return config.model_dump(mode='json', include={'mask_classes', 'mask_size', 'patch', 'masks', 'ego_fields'})


def _build(path: Path, folder: Path, codec: MaskCodec, config: ModelConfig, *, cameras: bool) -> None:
    purpose = 'training the raw stream' if cameras else 'training the privileged stream'
    wanted = [topics.BEV, topics.EGO, topics.TRANSITION, topics.IMU, topics.ODOMETRY, topics.ROUTE]
    wanted += extra_topics(config)
    with open_bag(path) as reader:
        if cameras:
            held = set(camera_topics(reader).values())
            wanted += [topics.image_topic(c) for c in topics.CAMERAS if c not in held]
        require_topics(reader, path, wanted, purpose)
        count = sum(c.msgcount for c in reader.connections if c.topic == topics.TRANSITION)
        if folder.is_dir() and not (folder / 'episodes.json').is_file():
            # Somebody has taken files away: what is written whole has all of them.
            shutil.rmtree(folder)
        with whole_folder(folder, keep_existing=True) as partial:
            counts = TickCounts()
            episodes = _fill(reader, path, partial, codec, config, count, counts, cameras=cameras)
            if counts.ticks == 0:
                raise BagError('; '.join([f'{path}: holds no complete tick', *counts.verdicts.lines()]))
            (partial / 'losses.json').write_text(json.dumps(asdict(Losses.of(counts))))
            (partial / 'episodes.json').write_text(json.dumps(episodes))


def _drives(
    reader: Any, path: Path, counts: TickCounts, extras: Sequence[str], *, cameras: bool
) -> Iterator[tuple[BagTick, dict[int, Advice]]]:
    """Every tick with the advice of its time line: a bag in which time goes back holds several, which share stamps."""
    for number, line in enumerate(time_lines(reader)):
        counts.back += number > 0
        advised = read_advice(line, RosbagsFactory(), counts.verdicts)
        for tick in read_ticks(line, path, cameras=cameras, counts=counts, extras=extras):
            yield tick, advised


def _inputs(frame: PrivilegedFrame, path: Path, config: ModelConfig) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """(masks, vector) that a model reads. Raises BagError where the bag lacks some of it."""
    try:
        return masks_of(frame, config), vector_of(frame, config)
    except ContractError as error:
        raise BagError(f'{path}: {error}; collect anew, or train with the `ego_fields` that the bag has') from error


def _fill(
    reader: Any,
    path: Path,
    folder: Path,
    codec: MaskCodec,
    config: ModelConfig,
    count: int,
    counts: TickCounts,
    *,
    cameras: bool,
) -> list[str]:
    """Write the arrays of at most `count` ticks; returns the names of the episodes."""
    masks = np.zeros((count, codec.packed_bytes), np.uint8)
    ego = np.zeros((count, config.ego_size), np.float32)
    vector = np.zeros((count, VECTOR_SIZE), np.float32)
    action, advice = np.zeros(count, np.int64), np.full(count, -1, np.int64)
    reward = np.zeros(count, np.float32)
    flags = np.zeros(count, np.uint8)
    images: Any = None
    episodes: list[str] = []
    progress, n, back = RouteProgress(), 0, 0
    for tick, advised in _drives(reader, path, counts, extra_topics(config), cameras=cameras):
        assert tick.privileged is not None and tick.transition is not None
        step = tick.transition
        if counts.back != back:
            progress, back = RouteProgress(), counts.back
        progress.update(tick.route, tick.odometry)
        bev, ego[n] = _inputs(tick.privileged, path, config)
        masks[n] = codec.pack(bev)
        vector[n] = raw_vector(tick.imu, tick.odometry, progress)
        cut = tick.starts_segment and not step.is_first
        action[n], reward[n] = -1 if cut else step.action, step.reward
        if tick.stamp_ns in advised:
            advice[n] = advised[tick.stamp_ns].action
        flags[n] = FIRST * (step.is_first or cut) + TERMINAL * step.is_terminal + LAST * step.is_last + CUT * cut
        if tick.starts_episode:
            episodes.append(tick.episode)
        if cameras:
            stack = _stack(tick, path, None if images is None else images.shape[1:])
            if images is None:
                images = np.lib.format.open_memmap(folder / 'images.npy', 'w+', np.uint8, (count, *stack.shape))
            images[n] = stack
        n += 1
    if cameras and images is not None:
        images.flush()
    if not advised and provenance_of(path).get('driver') == DEMONSTRATOR:
        same_sequence = (flags[1:n] & FIRST) == 0
        advice[: n - 1][same_sequence] = action[1:n][same_sequence]
    arrays: tuple[NDArray[Any], ...] = (masks, ego, vector, action, advice, reward, flags)
    for name, value in zip(ARRAYS, arrays, strict=True):
        np.save(folder / f'{name}.npy', value[:n])
    return episodes


def _stack(tick: BagTick, path: Path, shape: tuple[int, ...] | None) -> NDArray[np.uint8]:
    """(views, H, W, 3). Raises BagError where pictures differ in size from each other, or from those before."""
    pictures = [tick.images[camera] for camera in topics.CAMERAS]
    wanted = pictures[0].shape if shape is None else shape[1:]
    for camera, picture in zip(topics.CAMERAS, pictures, strict=True):
        if picture.shape != wanted:
            sizes = f'{picture.shape[0]}x{picture.shape[1]}, not {wanted[0]}x{wanted[1]}'
            raise BagError(f'{path}: camera {camera} at {tick.stamp_ns} ns: the picture is {sizes}')
    return np.stack(pictures)


def data_line(bags: Sequence[BagArrays], short: Sequence[Path], length: int) -> str:
    """What is trained on and what is not, in one line. short: bags with fewer than `length` ticks."""
    ticks, losses = sum(map(len, bags)), [bag.losses for bag in bags]
    refused = Counter[str]()
    for loss in losses:
        refused.update(loss.refused)
    by_topic = ', '.join(f'{topic} {count}' for topic, count in sorted(refused.items()))
    incomplete = sum(loss.incomplete for loss in losses)
    found = [
        ('ticks dropped', incomplete + sum(loss.missing for loss in losses), f' ({incomplete} incomplete)'),
        ('messages refused', refused.total(), f' ({by_topic})'),
        ('sequences cut', sum(loss.cuts for loss in losses), ''),
        ('first ticks of episodes lost', sum(loss.begins_lost for loss in losses), ''),
        ('last or terminal ones lost', sum(loss.ends_lost for loss in losses), ''),
        ('time went back', sum(loss.back for loss in losses), ''),
        (f'bags left out with fewer than {length} ticks', len(short), ''),
    ]
    said = ', '.join(f'{what} {count}{more}' for what, count, more in found if count)
    return f'data: bags {len(bags)}, ticks {ticks}, {said or "nothing left out"}'


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
