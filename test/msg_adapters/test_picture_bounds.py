"""Compressed pictures that unpack to more than any camera has."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from msg_adapters.compressed import compressed_image_to_message, image_from_compressed_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.bounds import MAX_PIXELS
from raw2drive_ros.contracts.errors import ContractError

FACTORY = RosbagsFactory()


def message_of(data: bytes):
    message = FACTORY.new('sensor_msgs/msg/CompressedImage')
    message.format, message.data = 'rgb8; png compressed bgr8', np.frombuffer(data, np.uint8)
    return message


def png(width: int, height: int) -> bytes:
    """A PNG of a few bytes that claims a size."""

    def part(kind: bytes, content: bytes) -> bytes:
        return struct.pack('>I', len(content)) + kind + content + struct.pack('>I', zlib.crc32(kind + content))

    head = struct.pack('>IIBBBBB', width, height, 8, 2, 0, 0, 0)
    return b'\x89PNG\r\n\x1a\n' + part(b'IHDR', head) + part(b'IDAT', zlib.compress(bytes(1000))) + part(b'IEND', b'')


def jpeg(width: int, height: int) -> bytes:
    """A JPEG whose frame claims a size, behind a comment."""
    whole = bytearray(cv2.imencode('.jpg', np.zeros((16, 16, 3), np.uint8))[1].tobytes())
    at = whole.index(b'\xff\xc0')
    struct.pack_into('>HH', whole, at + 5, height, width)
    return bytes(whole[:2] + b'\xff\xff\xfe\x00\x06abcd' + whole[2:])


@pytest.mark.parametrize('make', [png, jpeg])
def test_a_picture_that_claims_to_be_huge_is_refused_before_it_is_unpacked(make, monkeypatch) -> None:
    def unpack(*arguments):
        raise AssertionError('it would allocate what the picture claims')

    monkeypatch.setattr(cv2, 'imdecode', unpack)
    for width, height in ((30_000, 30_000), (MAX_PIXELS // 2 + 1, 2) if make is png else (65_535, 65_535)):
        with pytest.raises(ContractError, match=f'{height}x{width} pixels'):
            image_from_compressed_message(message_of(make(width, height)))


@pytest.mark.parametrize(
    'data',
    [
        b'',
        b'\xff\xd8',
        b'\xff\xd8' + b'\xff' * 1000,
        b'\xff\xd8\xff\xe0\x00\x00' * 100,
        png(4, 4)[:20],
        cv2.imencode('.bmp', np.zeros((8, 8, 3), np.uint8))[1].tobytes(),
    ],
)
def test_what_is_neither_jpeg_nor_png_is_refused(data) -> None:
    with pytest.raises(ContractError, match='cannot be decoded'):
        image_from_compressed_message(message_of(data))


@pytest.mark.parametrize(
    ('ending', 'flags'),
    [
        ('.jpg', ()),
        ('.jpg', (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
        ('.jpg', (cv2.IMWRITE_JPEG_RST_INTERVAL, 2)),
        ('.png', ()),
    ],
)
def test_pictures_of_all_kinds_are_read_as_before(ending, flags) -> None:
    image = np.random.default_rng(0).integers(0, 255, (37, 53, 3), np.uint8)
    packed = cv2.imencode(ending, image, flags)[1].tobytes()
    read = image_from_compressed_message(message_of(packed))
    assert np.array_equal(read, cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_COLOR)[..., ::-1])
    same = compressed_image_to_message(FACTORY, 'front', image, 5, 'png')
    assert np.array_equal(image_from_compressed_message(same), image)
