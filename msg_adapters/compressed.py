"""Compressed camera images: JPEG or PNG, as image_transport's `compressed` plugin publishes them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from msg_adapters.factory import MessageFactory, fill_bytes
from msg_adapters.sensors import optical_frame
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Image8

JPEG_QUALITY = 95
_JPEG = (int(cv2.IMWRITE_JPEG_QUALITY), JPEG_QUALITY)
# name in `format` -> (file extension for OpenCV, flags of its encoder)
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
    """(H, W, 3) uint8 RGB. Raises ContractError for bytes that are no image."""
    packed = np.frombuffer(message.data, np.uint8)
    image = cv2.imdecode(packed, cv2.IMREAD_COLOR) if packed.size else None
    if image is None:
        raise ContractError(f'compressed image ({message.format!r}, {packed.size} bytes) cannot be decoded')
    return np.ascontiguousarray(image[..., ::-1])
