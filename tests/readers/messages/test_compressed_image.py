import struct
from typing import Any

import builders
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.image import decode_compressed_image
from lidcam.readers.messages.image_header import image_size

STAMP_NS = 1_700_000_000_123_456_789


def decode(data: bytes, kind: str = "", encoding: builders.Encoding = "cdr", **options: Any) -> Image:
    body = {"header": builders.header(STAMP_NS, "/camera"), "format": kind, "data": np.frombuffer(data, np.uint8)}
    msgtype = "sensor_msgs/msg/CompressedImage"
    return decode_compressed_image(builders.raw("/compressed", msgtype, body, STAMP_NS, encoding=encoding), **options)


def encoded(pixels: Array, suffix: str) -> bytes:
    """A file of RGB, grey or RGBA pixels; OpenCV takes blue first."""
    codes = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}
    turned = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, codes[pixels.shape[2]])
    return bytes(np.asarray(cv2.imencode(suffix, turned)[1]).tobytes())


def noise(shape: tuple[int, ...], dtype: str = "u1") -> Array:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max + 1, shape, dtype)


def smooth() -> Array:
    rows, columns = np.mgrid[0:48, 0:64]
    return np.stack([rows * 5, columns * 4, 255 - rows * 2 - columns], -1).astype(np.uint8)


@pytest.mark.parametrize(
    ("kind", "encoding"), [("png", "cdr"), ("bgr8; png compressed ", "ros1"), ("", "cdr"), ("jpeg", "cdr")]
)
def test_png_is_exact_whatever_the_format_says(kind: str, encoding: builders.Encoding) -> None:
    pixels = noise((5, 7, 3))
    image = decode(encoded(pixels, ".png"), kind, encoding)
    np.testing.assert_array_equal(image.rgb, pixels)
    assert (image.stamp_ns, image.frame_id) == (STAMP_NS, "camera")


@pytest.mark.parametrize("kind", ["jpg", "rgb8; jpeg compressed bgr8"])
def test_jpeg(kind: str) -> None:
    found = decode(encoded(smooth(), ".jpg"), kind).rgb
    assert np.abs(found.astype(int) - smooth()).mean() < 2


TILE = np.array([[200, 100], [100, 50]], np.uint8)
GREY, WIDE, ALPHA = noise((5, 7)), noise((5, 7, 3), "u2"), noise((5, 7, 4))


@pytest.mark.parametrize(
    ("pixels", "kind", "expected"),
    [
        (GREY, "mono8; png compressed ", np.dstack([GREY] * 3)),
        (WIDE[..., 0], "mono16; png compressed ", np.dstack([WIDE[..., 0] >> 8] * 3)),
        (WIDE, "png", WIDE >> 8),
        (ALPHA, "png", ALPHA[..., :3]),
        (np.tile(TILE, (3, 4)), "bayer_rggb8; png compressed ", np.broadcast_to([200, 100, 50], (6, 8, 3))),
        (ALPHA[..., :3], "bayer_rggb8; png compressed bgr8", ALPHA[..., :3]),  # taken apart before
    ],
)
def test_pixels_become_rgb(pixels: Array, kind: str, expected: Array) -> None:
    np.testing.assert_array_equal(decode(encoded(np.ascontiguousarray(pixels), ".png"), kind).rgb, expected)


def test_exif_orientation_is_ignored() -> None:
    jpeg = encoded(smooth(), ".jpg")
    # TIFF, little endian: one entry, tag 0x0112 (orientation), type SHORT, value 6 (turn by 90 degrees).
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    segment = b"Exif\0\0" + tiff
    turned = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]
    as_shown = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert as_shown is not None
    assert as_shown.shape[:2] == (64, 48)  # the flag is there: a viewer turns this image
    np.testing.assert_array_equal(decode(turned, "jpeg").rgb, decode(jpeg, "jpeg").rgb)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_cut_data(suffix: str, share: float) -> None:
    whole = encoded(smooth(), suffix)
    with pytest.raises(MessageError, match=r"/compressed: \d+ bytes of format 'jpeg' are not a whole image"):
        decode(whole[: int(len(whole) * share)], "jpeg")


def test_what_is_no_image() -> None:
    broken = bytearray(encoded(smooth(), ".png"))
    broken[len(broken) // 2] ^= 0xFF
    small = encoded(noise((2, 2)), ".png")
    for data, kind in ((bytes(broken), "png"), (small, "bayer_rggb8; png compressed ")):
        with pytest.raises(MessageError, match="not a whole image"):
            decode(data, kind)
    with pytest.raises(MessageError, match=r"8 bytes of format 'h264' .* start with 6e 6f 20 69 6d 61 67 65"):
        decode(b"no image", "h264")


@pytest.mark.parametrize("kind", ["16UC1; compressedDepth", "32FC1; compressedDepth png"])
def test_depth_is_no_image(kind: str) -> None:
    with pytest.raises(MessageError, match="holds distances, expected an image"):
        decode(encoded(noise((5, 7), "u2"), ".png"), kind)


# --- the size of an image, from its header

SUFFIXES = [".jpg", ".png", ".webp", ".bmp", ".tiff", ".avif"]


def plain(width: int, height: int, suffix: str, *options: int, channels: int = 3) -> bytes:
    pixels = np.full((height, width, channels), 100, np.uint8)
    return bytes(np.asarray(cv2.imencode(suffix, pixels, [*options])[1]).tobytes())


@given(width=st.integers(1, 300), height=st.integers(1, 300), suffix=st.sampled_from(SUFFIXES[:5]))
def test_the_size_is_that_of_the_decoded_image(width: int, height: int, suffix: str) -> None:
    data = plain(width, height, suffix)
    assert image_size(data) == (width, height) == decode(data).rgb.shape[1::-1]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_image_that_is_too_large_is_not_unpacked(suffix: str) -> None:
    data = plain(1100, 1000, suffix)
    with pytest.raises(MessageError, match=r"/compressed: an image of 1100 x 1000 px, .* limit_scale"):
        decode(data, limits=RecordingLimits(max_image_mpx=1))
    assert decode(data).rgb.shape == (1000, 1100, 3)


def test_a_png_whose_chunk_is_longer_than_the_file() -> None:
    """OpenCV takes four gigabytes for it."""
    data = bytearray(plain(8, 6, ".png"))
    struct.pack_into(">I", data, data.index(b"IDAT") - 4, 2**32 - 162)
    with pytest.raises(MessageError, match="not a whole image"):
        decode(bytes(data))
