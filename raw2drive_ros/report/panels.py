"""Building blocks of pictures and videos: cameras, masks, command plots, text, and the MP4 file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Control

MOSAIC = (('front_left', 'front', 'front_right'), ('back_left', 'back', 'back_right'))
PLOT_TICKS = 120
PLOT_PX = 76
PAPER, INK, FRAME = 24, (235, 235, 235), (60, 60, 60)
Rgb = NDArray[np.uint8]


class Frames(Protocol):
    """Appends one picture to a video."""

    def __call__(self, picture: Rgb) -> None: ...


@contextmanager
def mp4(target: Path, width: int, height: int, rate: int) -> Iterator[Frames]:
    """Yields a function that appends one (height, width, 3) RGB picture."""
    import av

    with av.open(str(target), 'w', format='mp4') as container:
        stream = container.add_stream('libx264', rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, height, 'yuv420p'
        stream.options = {'crf': '24', 'preset': 'veryfast'}
        stream.codec_context.time_base = Fraction(1, rate)

        def append(picture: Rgb) -> None:
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format='rgb24')):
                container.mux(packet)

        yield append
        for packet in stream.encode():
            container.mux(packet)


def canvas_of(width: int, height: int) -> Rgb:
    """(height, width, 3) of dark grey."""
    return np.full((height, width, 3), PAPER, np.uint8)


def text(canvas: Rgb, words: str, where: tuple[int, int], size: float = 0.42, colour: Sequence[int] = INK) -> None:
    """where: (x, y) of the baseline's left end."""
    cv2.putText(canvas, words, where, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def put(canvas: Rgb, picture: Rgb, left: int, top: int, width: int, height: int, *, smooth: bool = True) -> None:
    """Scale a picture into a rectangle of the canvas."""
    how = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    canvas[top : top + height, left : left + width] = cv2.resize(picture, (width, height), interpolation=how)


def put_mosaic(
    canvas: Rgb, images: Mapping[str, Rgb], left: int, top: int, tile: tuple[int, int], crop: int = 0
) -> None:
    """The six cameras, in two rows of named tiles of (width, height); `crop` rows are cut off at the top and at the
    bottom of each."""
    width, height = tile
    for row, names in enumerate(MOSAIC):
        for column, name in enumerate(names):
            scaled = cv2.resize(images[name], (width, height + 2 * crop), interpolation=cv2.INTER_LINEAR)
            x, y = left + column * width, top + row * height
            canvas[y : y + height, x : x + width] = scaled[crop : crop + height]
            text(canvas, name.replace('_', ' '), (x + 6, y + 14))


def plot_controls(canvas: Rgb, history: Sequence[Control], left: int, top: int) -> None:
    """Throttle, brake and steer of the last `PLOT_TICKS` ticks, to the right edge of the canvas."""
    width = canvas.shape[1] - left - 12
    recent = history[-PLOT_TICKS:]
    rows = (
        ('throttle', (90, 200, 120), [c.throttle for c in recent], 0.0),
        ('brake', (230, 80, 70), [c.brake for c in recent], 0.0),
        ('steer (left up)', (90, 160, 255), [c.steer for c in recent], -1.0),
    )
    for i, (title, colour, values, low) in enumerate(rows):
        y0 = top + i * (PLOT_PX + 14)
        cv2.rectangle(canvas, (left, y0), (left + width, y0 + PLOT_PX), FRAME, 1)
        text(canvas, title, (left + 4, y0 + 13))
        if len(values) > 1:
            x = left + np.arange(len(values)) * width / (PLOT_TICKS - 1)
            y = y0 + PLOT_PX - 3 - (np.array(values) - low) / (1.0 - low) * (PLOT_PX - 6)
            points = np.stack([x, y], 1).astype(np.int32)
            cv2.polylines(canvas, [points], isClosed=False, color=colour, thickness=1, lineType=cv2.LINE_AA)
