"""A recorded drive as MP4: camera mosaic, BEV truth beside the model's reconstruction, commands over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.ticks import BagTick, read_ticks
from raw2drive_ros.report.panels import Rgb, canvas_of, mp4, plot_controls, put, put_mosaic, text
from raw2drive_ros.tables.bev_colours import colour_masks
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.privileged_inputs import masks_of

WIDTH, HEIGHT, RATE = 960, 640, 20
BEV_PX = 256


@dataclass(slots=True)
class Video:
    """Where the video is, and stills of it (RGB) by episode, for the report."""

    path: Path
    stills: dict[str, Rgb] = field(default_factory=dict)


def write_video(bag: Path, bundle_path: Path, target: Path, advance: Callable[..., None] = lambda done: None) -> Video:
    """Replay a bag's sensor data through the bundle's driver and draw every tick. Raises BagError, BundleError."""
    bundle = load_bundle(bundle_path)
    driver = RawDriver(bundle)
    codec = MaskCodec(bundle.config)
    names = list(bundle.config.mask_classes)
    extras = (topics.BEV_VISIBLE,) * (bundle.config.masks == 'visible')
    video = Video(target)
    history: list[Control] = []
    episode, shown = '', 0
    with open_bag(bag) as reader, mp4(target, WIDTH, HEIGHT, RATE) as append:
        total = next((c.msgcount for c in reader.connections if c.topic == topics.TRANSITION), 1)
        for index, tick in enumerate(read_ticks(reader, bag, cameras=True, extras=extras)):
            if tick.episode != episode:
                episode, shown = tick.episode, 0
                driver.reset()
                history.clear()
            frame = SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry)
            decision = driver.drive(frame, tick.route)
            history.append(decision.control)
            belief = codec.to_image_order(driver.reconstruct()[None])[0]
            assert tick.privileged is not None
            truth = codec.merge(masks_of(tick.privileged, bundle.config)).astype(np.float32)
            picture = _compose(tick, colour_masks(truth, names), colour_masks(belief, names), history)
            shown += 1
            if shown == 80 or tick.episode not in video.stills:
                video.stills[tick.episode] = picture
            append(picture)
            advance(min(1.0, (index + 1) / total))
    return video


def _compose(tick: BagTick, truth: Rgb, belief: Rgb, history: list[Control]) -> Rgb:
    canvas = canvas_of(WIDTH, HEIGHT)
    put_mosaic(canvas, tick.images, 0, 0, (WIDTH // 3, 160), crop=16)
    top = 2 * 160 + 34
    for left, picture, title in ((12, truth, 'BEV truth'), (12 + BEV_PX + 12, belief, 'BEV from cameras')):
        put(canvas, picture, left, top, BEV_PX, BEV_PX, smooth=False)
        text(canvas, title, (left, top - 8))
    plot_controls(canvas, history, 12 + 2 * (BEV_PX + 12) + 8, top)
    text(canvas, f'speed x{RATE / DECISION_HZ:g}', (WIDTH - 90, top - 8))
    words = f'{tick.episode}   t {tick.stamp_ns * 1e-9:7.1f} s   {tick.odometry.speed_mps * 3.6:5.1f} km/h'
    text(canvas, words, (560, HEIGHT - 10))
    return canvas
