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
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.image import decode_compressed_image, decode_image
from lidcam.readers.messages.image_header import image_size

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "sensor_msgs/msg/Image"

# Where red, green and blue (and alpha) lie in a pixel.
COLOURS = {"rgb": [0, 1, 2], "rgba": [0, 1, 2, 3], "bgr": [2, 1, 0], "bgra": [2, 1, 0, 3]}
MATRICES = {"8UC3": [2, 1, 0], "8UC4": [2, 1, 0, 3], "16UC3": [2, 1, 0], "16UC4": [2, 1, 0, 3]}
ORDERS = {f"{name}{bits}": order for name, order in COLOURS.items() for bits in (8, 16)} | MATRICES
GREYS = ["mono8", "mono16", "8UC1", "16UC1"]
SIDE = st.integers(1, 5)


def message(pixels: Array, encoding: str, msg_encoding: builders.Encoding = "cdr", **options: Any) -> RawMessage:
    body = builders.image(pixels, stamp_ns=STAMP_NS, encoding=encoding, **options)
    return builders.raw("/image", MSGTYPE, body, STAMP_NS, encoding=msg_encoding)


def decode(pixels: Array, encoding: str, **options: Any) -> Image:
    return decode_image(message(pixels, encoding, **options))


def changed(encoding: str = "rgb8", **changes: Any) -> RawMessage:
    body = builders.image(np.zeros((4, 6, 3), np.uint8), stamp_ns=STAMP_NS, encoding=encoding)
    return builders.raw("/image", MSGTYPE, {**body, **changes}, STAMP_NS)


# --- colour and grey


@given(st.sampled_from([*ORDERS, *GREYS]), SIDE, SIDE, st.integers(0, 7), st.booleans(), st.integers(0, 99))
def test_values_as_numpy_reorders_them(
    encoding: str, height: int, width: int, row_padding: int, is_bigendian: bool, seed: int
) -> None:
    wide = "16" in encoding
    dtype = np.dtype((">" if is_bigendian else "<") + ("u2" if wide else "u1"))
    order = ORDERS.get(encoding, [0])
    values = np.random.default_rng(seed).integers(0, 65536 if wide else 256, (height, width, len(order)))
    image = decode(values.astype(dtype), encoding, row_padding=row_padding, is_bigendian=is_bigendian)
    eight = values >> 8 if wide else values
    expected = eight[..., order[:3]] if len(order) > 1 else np.repeat(eight, 3, -1)
    np.testing.assert_array_equal(image.rgb, expected)
    assert (image.stamp_ns, image.frame_id) == (STAMP_NS, "camera")


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_rgb8_is_not_copied(encoding: builders.Encoding) -> None:
    raw = message(np.arange(24, dtype=np.uint8).reshape(2, 4, 3), "rgb8", encoding)
    assert np.shares_memory(decode_image(raw).rgb, np.frombuffer(raw.data, np.uint8))


# --- Bayer

RED, GREEN, BLUE = 200, 100, 50
TILES = {
    "rggb": [[RED, GREEN], [GREEN, BLUE]],
    "bggr": [[BLUE, GREEN], [GREEN, RED]],
    "gbrg": [[GREEN, BLUE], [RED, GREEN]],
    "grbg": [[GREEN, RED], [BLUE, GREEN]],
}


@pytest.mark.parametrize("pattern", TILES)
@pytest.mark.parametrize(("shape", "bits"), [((3, 3), 8), ((4, 6), 16), ((5, 7), 8)])
def test_mosaic_of_one_colour(pattern: str, shape: tuple[int, int], bits: int) -> None:
    mosaic = np.tile(np.array(TILES[pattern], f"u{bits // 8}"), (3, 4))[: shape[0], : shape[1]]
    if bits == 16:
        mosaic = (mosaic << 8) + 7
    image = decode(mosaic, f"bayer_{pattern}{bits}", row_padding=3)
    np.testing.assert_array_equal(image.rgb, np.broadcast_to([RED, GREEN, BLUE], (*shape, 3)))


# --- YUV


def yuv_of(rgb: Array) -> Array:
    """ITU-R BT.601, limited range, from its definition: Kr 0.299, Kb 0.114; Y 16 to 235, U and V 16 to 240."""
    red, green, blue = np.moveaxis(rgb / 255.0, -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    planes = [16 + 219 * luma, 128 + 224 * (blue - luma) / (2 - 2 * 0.114), 128 + 224 * (red - luma) / (2 - 2 * 0.299)]
    return np.asarray(np.rint(np.stack(planes, -1)), np.uint8)


def colour_blocks() -> Array:
    """(16, 24, 3): blocks of 4 x 4 pixels, so that pixels which share U and V have one colour."""
    blocks = np.random.default_rng(3).integers(0, 256, (4, 6, 3), np.uint8)
    return np.repeat(np.repeat(blocks, 4, 0), 4, 1)


def packed_yuv(yuv: Array, order: str) -> Array:
    """(H, W, 2) bytes of two pixels in the order given, for instance `uyvy`."""
    first, second = yuv[:, 0::2], yuv[:, 1::2]
    parts = {"u": first[..., 1], "v": first[..., 2]}
    lumas = iter([first[..., 0], second[..., 0]])
    groups = np.stack([next(lumas) if letter == "y" else parts[letter] for letter in order], -1)
    return np.asarray(groups.reshape(yuv.shape[0], yuv.shape[1], 2))


@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")]
)
def test_packed_yuv(encoding: str, order: str) -> None:
    rgb = colour_blocks()
    found = decode(packed_yuv(yuv_of(rgb), order), encoding, row_padding=6).rgb
    assert np.abs(found.astype(int) - rgb).max() <= 4


@pytest.mark.parametrize("encoding", ["nv12", "nv21", "nv24"])
@pytest.mark.parametrize("row_padding", [0, 5])
def test_planar_yuv(encoding: str, row_padding: int) -> None:
    rgb = colour_blocks()
    yuv = yuv_of(rgb)
    height, width = rgb.shape[:2]
    step = width + row_padding
    chroma = yuv[..., [2, 1]] if encoding == "nv21" else yuv[..., 1:]
    if encoding == "nv24":
        chroma_rows = np.pad(chroma.reshape(height, 2 * width), ((0, 0), (0, 2 * row_padding)))
    else:
        chroma_rows = np.pad(chroma[::2, ::2].reshape(height // 2, width), ((0, 0), (0, row_padding)))
    luma_rows = np.pad(yuv[..., 0], ((0, 0), (0, row_padding)))
    data = np.concatenate([luma_rows.reshape(-1), chroma_rows.reshape(-1)])
    found = decode_image(changed(encoding, height=height, width=width, step=step, data=data)).rgb
    assert np.abs(found.astype(int) - rgb).max() <= 4


# --- what is no image, and what contradicts itself


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"encoding": "32FC1"}, r"encoding '32FC1' is not an image; expected one of rgb8"),
        ({"encoding": ""}, r"encoding ''"),
        ({"height": 5}, r"rgb8 of 6 x 5 px has 5 rows of 18 bytes or more, found a step of 18 bytes and 72 bytes"),
        ({"step": 17}, r"4 rows of 18 bytes or more, found a step of 17 bytes"),
        ({"width": 2**32 - 1, "height": 2**32 - 1, "step": 2**32 - 1}, r"4294967295 x 4294967295 px"),
        ({"encoding": "rgb16"}, r"4 rows of 36 bytes"),
        ({"encoding": "nv12", "step": 18}, r"6 rows of 6 bytes or more, found a step of 18 bytes and 72 bytes"),
        ({"encoding": "uyvy", "width": 5}, r"uyvy needs an even width, found 5 px"),
        ({"encoding": "nv12", "height": 3}, r"nv12 needs an even width and height, found 6 x 3 px"),
        ({"encoding": "bayer_rggb8", "width": 2}, r"expected 3 x 3 px or more"),
        ({"height": 0}, r"an image of 6 x 0 px in rgb8; expected 1 x 1 px or more"),
        ({"width": 0, "encoding": "nv24"}, r"an image of 0 x 4 px"),
        ({"data": np.zeros(0, np.uint8)}, r"0 bytes of data"),
    ],
)
def test_contradictions_are_named(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(MessageError, match=match):
        decode_image(changed(**changes))


# --- compressed images


def decode_file(data: bytes, kind: str = "", encoding: builders.Encoding = "cdr", **options: Any) -> Image:
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
    image = decode_file(encoded(pixels, ".png"), kind, encoding)
    np.testing.assert_array_equal(image.rgb, pixels)
    assert (image.stamp_ns, image.frame_id) == (STAMP_NS, "camera")


@pytest.mark.parametrize("kind", ["jpg", "rgb8; jpeg compressed bgr8"])
def test_jpeg(kind: str) -> None:
    found = decode_file(encoded(smooth(), ".jpg"), kind).rgb
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
    np.testing.assert_array_equal(decode_file(encoded(np.ascontiguousarray(pixels), ".png"), kind).rgb, expected)


def test_exif_orientation_is_ignored() -> None:
    jpeg = encoded(smooth(), ".jpg")
    # TIFF, little endian: one entry, tag 0x0112 (orientation), type SHORT, value 6 (turn by 90 degrees).
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    segment = b"Exif\0\0" + tiff
    turned = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]
    as_shown = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert as_shown is not None
    assert as_shown.shape[:2] == (64, 48)  # the flag is there: a viewer turns this image
    np.testing.assert_array_equal(decode_file(turned, "jpeg").rgb, decode_file(jpeg, "jpeg").rgb)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_cut_data(suffix: str, share: float) -> None:
    whole = encoded(smooth(), suffix)
    with pytest.raises(MessageError, match=r"/compressed: \d+ bytes of format 'jpeg' are not a whole image"):
        decode_file(whole[: int(len(whole) * share)], "jpeg")


def test_what_is_no_image() -> None:
    broken = bytearray(encoded(smooth(), ".png"))
    broken[len(broken) // 2] ^= 0xFF
    small = encoded(noise((2, 2)), ".png")
    for data, kind in ((bytes(broken), "png"), (small, "bayer_rggb8; png compressed ")):
        with pytest.raises(MessageError, match="not a whole image"):
            decode_file(data, kind)
    with pytest.raises(MessageError, match=r"8 bytes of format 'h264' .* start with 6e 6f 20 69 6d 61 67 65"):
        decode_file(b"no image", "h264")


@pytest.mark.parametrize("kind", ["16UC1; compressedDepth", "32FC1; compressedDepth png"])
def test_depth_is_no_image(kind: str) -> None:
    with pytest.raises(MessageError, match="holds distances, expected an image"):
        decode_file(encoded(noise((5, 7), "u2"), ".png"), kind)


# --- the size of an image, from its header

SUFFIXES = [".jpg", ".png", ".webp", ".bmp", ".tiff", ".avif"]


def plain(width: int, height: int, suffix: str, *options: int, channels: int = 3) -> bytes:
    pixels = np.full((height, width, channels), 100, np.uint8)
    return bytes(np.asarray(cv2.imencode(suffix, pixels, [*options])[1]).tobytes())


@given(width=st.integers(1, 300), height=st.integers(1, 300), suffix=st.sampled_from(SUFFIXES[:5]))
def test_the_size_is_that_of_the_decoded_image(width: int, height: int, suffix: str) -> None:
    data = plain(width, height, suffix)
    assert image_size(data) == (width, height) == decode_file(data).rgb.shape[1::-1]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_image_that_is_too_large_is_not_unpacked(suffix: str) -> None:
    data = plain(1100, 1000, suffix)
    with pytest.raises(MessageError, match=r"/compressed: an image of 1100 x 1000 px, .* limit_scale"):
        decode_file(data, limits=RecordingLimits(max_image_mpx=1))
    assert decode_file(data).rgb.shape == (1000, 1100, 3)


def test_a_png_whose_chunk_is_longer_than_the_file() -> None:
    """OpenCV takes four gigabytes for it."""
    data = bytearray(plain(8, 6, ".png"))
    struct.pack_into(">I", data, data.index(b"IDAT") - 4, 2**32 - 162)
    with pytest.raises(MessageError, match="not a whole image"):
        decode_file(bytes(data))
