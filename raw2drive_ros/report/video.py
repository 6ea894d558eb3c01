"""A drive as MP4: camera mosaic, BEV truth beside the model's reconstruction, commands over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros import topics
from raw2drive_ros.contract import Control, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.driver import RawDriver
from raw2drive_ros.recording.bag_reader import BagTick, open_bag, read_ticks
from raw2drive_ros.recording.masks import MaskCodec
from raw2drive_ros.report.colours import colour_masks

WIDTH, HEIGHT, RATE = 960, 640, 20
MOSAIC = (('front_left', 'front', 'front_right'), ('back_left', 'back', 'back_right'))
BEV_PX, PLOT_TICKS = 256, 120
Rgb = NDArray[np.uint8]


@dataclass(slots=True)
class Video:
    """Where the video is, and stills of it (RGB) by episode, for the report."""

    path: Path
    stills: dict[str, Rgb] = field(default_factory=dict)


def write_video(bag: Path, bundle_path: Path, target: Path, advance: Callable[..., None] = lambda done: None) -> Video:
    """Replay a bag's sensors through the bundle's driver and draw every tick. Raises BagError, BundleError."""
    import av

    bundle = load_bundle(bundle_path)
    driver = RawDriver(bundle)
    codec = MaskCodec(bundle.config)
    names = list(bundle.config.mask_classes)
    video = Video(target)
    history: list[Control] = []
    episode, shown = '', 0
    with open_bag(bag) as reader, av.open(str(target), 'w') as container:
        total = next((c.msgcount for c in reader.connections if c.topic == topics.TRANSITION), 1)
        stream = container.add_stream('libx264', rate=RATE)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, 'yuv420p'
        stream.options = {'crf': '24', 'preset': 'veryfast'}
        stream.codec_context.time_base = Fraction(1, RATE)
        for index, tick in enumerate(read_ticks(reader, bag, cameras=True)):
            if tick.episode != episode:
                episode, shown = tick.episode, 0
                driver.reset()
                history.clear()
            frame = SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry)
            decision = driver.drive(frame, tick.route)
            history.append(decision.control)
            belief = codec.to_image_order(driver.reconstruct()[None])[0]
            assert tick.privileged is not None
            truth = codec.merge(tick.privileged.bev).astype(np.float32)
            picture = _compose(tick, colour_masks(truth, names), colour_masks(belief, names), history)
            shown += 1
            if shown == 80 or tick.episode not in video.stills:
                video.stills[tick.episode] = picture
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format='rgb24')):
                container.mux(packet)
            advance(min(1.0, (index + 1) / total))
        for packet in stream.encode():
            container.mux(packet)
    return video


def _compose(tick: BagTick, truth: Rgb, belief: Rgb, history: list[Control]) -> Rgb:
    canvas = np.full((HEIGHT, WIDTH, 3), 24, np.uint8)
    width, height = WIDTH // 3, 160
    for row, names in enumerate(MOSAIC):
        for column, name in enumerate(names):
            tile = cv2.resize(tick.images[name], (width, 192), interpolation=cv2.INTER_LINEAR)[16:176]
            canvas[row * height : (row + 1) * height, column * width : (column + 1) * width] = tile
            _text(canvas, name.replace('_', ' '), (column * width + 6, row * height + 14))
    top = 2 * height + 34
    for left, picture, title in ((12, truth, 'BEV truth'), (12 + BEV_PX + 12, belief, 'BEV from cameras')):
        side = cv2.resize(picture, (BEV_PX, BEV_PX), interpolation=cv2.INTER_NEAREST)
        canvas[top : top + BEV_PX, left : left + BEV_PX] = side
        _text(canvas, title, (left, top - 8))
    _plot(canvas, history, 12 + 2 * (BEV_PX + 12) + 8, top)
    speed = f'{tick.episode}   t {tick.stamp_ns * 1e-9:7.1f} s   {tick.odometry.speed_mps * 3.6:5.1f} km/h'
    _text(canvas, speed, (560, HEIGHT - 10))
    return canvas


def _plot(canvas: Rgb, history: list[Control], left: int, top: int) -> None:
    """Throttle, brake and steer of the last `PLOT_TICKS` ticks."""
    width, height = WIDTH - left - 12, 76
    recent = history[-PLOT_TICKS:]
    rows = (
        ('throttle', (90, 200, 120), [c.throttle for c in recent], 0.0),
        ('brake', (230, 80, 70), [c.brake for c in recent], 0.0),
        ('steer (left up)', (90, 160, 255), [c.steer for c in recent], -1.0),
    )
    for i, (title, colour, values, low) in enumerate(rows):
        y0 = top + i * (height + 14)
        cv2.rectangle(canvas, (left, y0), (left + width, y0 + height), (60, 60, 60), 1)
        _text(canvas, title, (left + 4, y0 + 13))
        if len(values) > 1:
            x = left + np.arange(len(values)) * width / (PLOT_TICKS - 1)
            y = y0 + height - 3 - (np.array(values) - low) / (1.0 - low) * (height - 6)
            points = np.stack([x, y], 1).astype(np.int32)
            cv2.polylines(canvas, [points], False, colour, 1, cv2.LINE_AA)


def _text(canvas: Rgb, text: str, where: tuple[int, int]) -> None:
    cv2.putText(canvas, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)
