"""Compressed camera images: JPEG or PNG, as image_transport's `compressed` plugin publishes them."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np

from msg_adapters.factory import MessageFactory, fill_bytes
from msg_adapters.sensors import optical_frame
from msg_adapters.stamps import set_stamp
from raw2drive_ros.bounds import MAX_PIXELS
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Image8

JPEG_QUALITY = 95
_JPEG = (int(cv2.IMWRITE_JPEG_QUALITY), JPEG_QUALITY)
# name in `format` -> (file extension for OpenCV, flags of its encoder)
# The size of a JPEG stands behind its comments, colour profile and preview.
MAX_HEAD_BYTES = 2**20
_PNG = b'\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR'
# Markers that begin a frame, among which are other tables; and those without a length.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = frozenset((0x01, *range(0xD0, 0xD9)))
ENCODERS = {'jpeg': ('.jpg', _JPEG), 'png': ('.png', ())}


def compressed_image_to_message(
    factory: MessageFactory, camera: str, image: Image8, time_ns: int, encoding: str = 'jpeg'
) -> Any:
    """(H, W, 3) uint8 RGB -> CompressedImage in the optical frame. PNG keeps every bit, JPEG does not.

    Raises ContractError for an unknown encoding.
    """
    if encoding not in ENCODERS:
        raise ContractError(f'image compression {encoding!r} is not supported; use one of {", ".join(ENCODERS)}')
    ending, flags = ENCODERS[encoding]
    done, packed = cv2.imencode(ending, image[..., ::-1], flags)
    if not done:
        raise ContractError(f'camera {camera}: an image of shape {image.shape} cannot be compressed')
    message = factory.new('sensor_msgs/msg/CompressedImage')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = optical_frame(camera)
    # image_transport's wording: pixel format, what it was packed with, order of channels inside.
    message.format = f'rgb8; {encoding} compressed bgr8'
    message.data = factory.byte_buffer(packed.size)
    fill_bytes(message.data, packed)
    return message


def image_from_compressed_message(message: Any) -> Image8:
    """(H, W, 3) uint8 RGB. Raises ContractError for bytes that are no JPEG or PNG, or of too many pixels."""
    packed = np.frombuffer(message.data, np.uint8)
    height, width = _size(packed[:MAX_HEAD_BYTES].tobytes())
    if height * width > MAX_PIXELS:
        raise ContractError(f'compressed image of {height}x{width} pixels, and no more than {MAX_PIXELS} are unpacked')
    image = cv2.imdecode(packed, cv2.IMREAD_COLOR) if height * width else None
    if image is None:
        raise ContractError(f'compressed image ({message.format!r}, {packed.size} bytes) cannot be decoded')
    return np.ascontiguousarray(image[..., ::-1])


def _size(head: bytes) -> tuple[int, int]:
    """(height, width) in pixels that the head of a JPEG or PNG claims, which is what a decoder allocates; (0, 0) where
    it is neither."""
    if head.startswith(_PNG) and len(head) >= len(_PNG) + 8:
        width, height = struct.unpack_from('>II', head, len(_PNG))
        return height, width
    at = 2
    while head.startswith(b'\xff\xd8') and at + 9 <= len(head) and head[at] == 0xFF:
        marker = head[at + 1]
        if marker == 0xFF:
            at += 1
        elif marker in _JPEG_BARE:
            at += 2
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from('>HH', head, at + 5)
            return height, width
        else:
            at += 2 + struct.unpack_from('>H', head, at + 2)[0]
    return 0, 0
