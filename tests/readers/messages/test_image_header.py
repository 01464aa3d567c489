"""What an image says of its size, against OpenCV."""

import struct
from typing import Any

import builders
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import MessageError
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import LimitsConfig
from readers.messages.image import decode_any_image
from readers.messages.image_header import image_size

SUFFIXES = [".jpg", ".png", ".webp", ".bmp", ".tiff", ".avif"]


def encoded(width: int, height: int, suffix: str, *options: int, channels: int = 3) -> bytes:
    pixels = np.full((height, width, channels), 100, np.uint8)
    return bytes(np.asarray(cv2.imencode(suffix, pixels, [*options])[1]).tobytes())


def compressed(data: bytes) -> RawMessage:
    body: dict[str, Any] = {"header": builders.header(0, "camera"), "format": "", "data": np.frombuffer(data, np.uint8)}
    return builders.raw("/image", "sensor_msgs/msg/CompressedImage", body, 0)


@settings(deadline=None)
@given(width=st.integers(1, 300), height=st.integers(1, 300), suffix=st.sampled_from(SUFFIXES[:5]))
def test_the_size_is_that_of_the_decoded_image(width: int, height: int, suffix: str) -> None:
    data = encoded(width, height, suffix)
    assert image_size(data) == (width, height) == decode_any_image(compressed(data)).rgb.shape[1::-1]


@pytest.mark.parametrize(
    ("suffix", "options", "channels"),
    [
        (".avif", (), 3),
        (".jpg", (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), 3),
        (".jpg", (cv2.IMWRITE_JPEG_RST_INTERVAL, 1), 3),
        (".jpg", (), 1),
        (".webp", (cv2.IMWRITE_WEBP_QUALITY, 50), 3),
        (".webp", (cv2.IMWRITE_WEBP_QUALITY, 50), 4),
        (".png", (), 4),
        (".tiff", (cv2.IMWRITE_TIFF_COMPRESSION, 1), 3),
        (".tiff", (cv2.IMWRITE_TIFF_COMPRESSION, 8), 1),
        (".tiff", (cv2.IMWRITE_TIFF_ROWSPERSTRIP, 7), 4),
    ],
)
def test_forms_of_one_kind(suffix: str, options: tuple[int, ...], channels: int) -> None:
    data = encoded(70, 50, suffix, *options, channels=channels)
    assert image_size(data) == (70, 50) == decode_any_image(compressed(data)).rgb.shape[1::-1]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_image_that_is_too_large_is_not_unpacked(suffix: str) -> None:
    data = encoded(1100, 1000, suffix)
    with pytest.raises(MessageError, match=r"/image: an image of 1100 x 1000 px, .* limits\.max_image_mpx"):
        decode_any_image(compressed(data), limits=LimitsConfig(max_image_mpx=1))
    assert decode_any_image(compressed(data)).rgb.shape == (1000, 1100, 3)


def test_a_jpeg_of_scans_without_end() -> None:
    whole = encoded(70, 50, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    last = whole.rindex(b"\xff\xda")
    scan = whole[last:-2]
    assert image_size(whole[:-2] + scan * 200 + b"\xff\xd9") is None


@pytest.mark.parametrize("suffix", [".jp2", ".pbm", ".hdr", ".gif"])
def test_other_kinds_are_not_read(suffix: str) -> None:
    data = encoded(8, 8, suffix)
    with pytest.raises(MessageError, match="expected JPEG, PNG, WebP, AVIF, TIFF or BMP"):
        decode_any_image(compressed(data))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_data_that_end_too_soon(suffix: str) -> None:
    data = encoded(70, 50, suffix)
    assert {image_size(data[:end]) for end in range(len(data))} <= {None, (70, 50)}
    assert image_size(data[:20]) is None


def test_a_png_whose_chunk_is_longer_than_the_file() -> None:
    """OpenCV takes four gigabytes for it."""
    data = bytearray(encoded(8, 6, ".png"))
    struct.pack_into(">I", data, data.index(b"IDAT") - 4, 2**32 - 162)
    with pytest.raises(MessageError, match="not a whole image"):
        decode_any_image(compressed(bytes(data)))


@given(st.binary(max_size=60), st.sampled_from([b"\xff\xd8\xff", b"BM", b"RIFF\0\0\0\0WEBP", b"\0\0\0\0ftypavif"]))
def test_any_bytes(rest: bytes, begin: bytes) -> None:
    size = image_size(begin + rest)
    assert size is None or (size[0] >= 0 <= size[1])


def test_a_bmp_upside_down() -> None:
    data = bytearray(encoded(8, 6, ".bmp"))
    struct.pack_into("<i", data, 22, -6)
    assert image_size(bytes(data)) == (8, 6)


TIFF_TAGS = {"width": 256, "length": 257, "bits": 258, "samples": 277, "strip bytes": 279}


def tiff(**changes: int) -> bytes:
    """A TIFF of 70 x 50 px with other values, or counts of values (`strip_bytes_count`), in its directory."""
    data = bytearray(encoded(70, 50, ".tiff"))
    (directory,) = struct.unpack_from("<I", data, 4)
    (fields,) = struct.unpack_from("<H", data, directory)
    for name, value in changes.items():
        tag = TIFF_TAGS[name.removesuffix("_count").replace("_", " ")]
        [at] = [
            at
            for at in range(directory + 2, directory + 2 + 12 * fields, 12)
            if data[at : at + 2] == tag.to_bytes(2, "little")
        ]
        if name.endswith("_count"):
            struct.pack_into("<I", data, at + 4, value)
        else:
            struct.pack_into("<HII", data, at + 2, 4, 1, value)
    return bytes(data)


def test_a_tiff_says_its_size() -> None:
    assert image_size(tiff(width=40_000, length=30_000)) == (40_000, 30_000)


@pytest.mark.parametrize("changes", [{"samples": 60_000}, {"bits_count": 1 << 30}, {"strip_bytes_count": 1 << 31}])
def test_a_tiff_whose_numbers_do_not_fit_the_file(changes: dict[str, int]) -> None:
    assert image_size(tiff(**changes)) is None
    with pytest.raises(MessageError, match="not a whole image"):
        decode_any_image(compressed(tiff(**changes)))


def test_a_tiff_whose_fields_share_their_data() -> None:
    """OpenCV copies the data once for each field: two gigabytes from this megabyte."""
    needed = [(256, 3, 1, 70), (257, 3, 1, 50), (258, 3, 1, 8), (262, 3, 1, 1), (273, 4, 1, 8), (279, 4, 1, 100)]
    fields = [*needed, *((40_000 + i, 7, 10**6, 8) for i in range(2000))]
    head = struct.pack("<4sIH", b"II*\0", 8, len(fields)) + b"".join(struct.pack("<HHII", *field) for field in fields)
    with pytest.raises(MessageError, match="not a whole image"):
        decode_any_image(compressed(head.ljust(10**6 + 100, b"\0")))
