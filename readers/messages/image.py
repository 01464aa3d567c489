"""Decodes sensor_msgs/Image and sensor_msgs/CompressedImage.

Pixels are converted from the encodings of sensor_msgs/image_encodings.hpp (ROS 1 Noetic to ROS 2 Lyrical) to 8-bit RGB.

| encoding | taken as |
| --- | --- |
| rgb8 rgba8 bgr8 bgra8, and the same with 16 | colour; alpha is ignored |
| mono8 mono16 8UC1 16UC1 | grey |
| 8UC3 8UC4 16UC3 16UC4 | BGR and BGRA, OpenCV's order |
| bayer_rggb8 ... bayer_grbg16 | mosaic, named by the first row's two pixels and the second row's; bilinear |
| yuv422 = uyvy, yuv422_yuy2 = yuyv | two pixels in four bytes, ITU-R BT.601, limited range |
| nv12 nv21 nv24 | plane of Y, then of U and V in turn (nv21: V and U), ITU-R BT.601, limited range |

Of 16 bits the upper eight are kept (`value >> 8`), so images of 12-bit sensors that do not shift their values up are
dark. Signed, float and two-channel encodings hold measurements, not images. OpenCV is imported where pixels are
converted: most runs copy images as they are.
"""

from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.image_header import KINDS, image_size
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.messages.tf import clean_frame


class PackedEncoding(NamedTuple):
    """An encoding with all values of a pixel side by side."""

    channels: int  # Values per pixel
    depth_bytes: int  # Bytes per value, 1 or 2
    conversion: str | None  # OpenCV's name for the conversion to RGB; None for RGB itself
    mosaic: bool = False  # Whether each pixel has only one colour
    pixels_per_group: int = 1  # Pixels that share values; the width is a multiple of it


def _packed_encodings() -> dict[str, PackedEncoding]:
    encodings = {}
    for bits in (8, 16):
        depth = bits // 8
        for name, channels, code in _COLOURS:
            encodings[name.format(bits)] = PackedEncoding(channels, depth, code and f"COLOR_{code}2RGB")
        for order in ("RGGB", "BGGR", "GBRG", "GRBG"):  # as ROS names them; OpenCV's older names say BayerBG for RGGB
            name, code = f"bayer_{order.lower()}{bits}", f"COLOR_Bayer{order}2RGB"
            encodings[name] = PackedEncoding(1, depth, code, mosaic=True)
    for name, code in (("yuv422", "UYVY"), ("uyvy", "UYVY"), ("yuv422_yuy2", "YUY2"), ("yuyv", "YUY2")):
        encodings[name] = PackedEncoding(2, 1, f"COLOR_YUV2RGB_{code}", pixels_per_group=2)
    return encodings


_COLOURS = (
    ("rgb{}", 3, None),
    ("rgba{}", 4, "RGBA"),
    ("bgr{}", 3, "BGR"),
    ("bgra{}", 4, "BGRA"),
    ("mono{}", 1, "GRAY"),
    ("{}uc1", 1, "GRAY"),
    ("{}uc3", 3, "BGR"),
    ("{}uc4", 4, "BGRA"),
)
"""Name by bits, values per pixel and order of OpenCV."""

PACKED = _packed_encodings()
"""Encodings by name in lower case."""

PLANAR = {"nv12": "COLOR_YUV2RGB_NV12", "nv21": "COLOR_YUV2RGB_NV21", "nv24": None}
"""OpenCV's name for the conversion, by name in lower case; it has none for nv24."""

# ITU-R BT.601 with Y in 16..235 and U, V in 16..240, the numbers that OpenCV uses for the other YUV encodings.
_RGB_FROM_YUV = np.array([[1.164, 0.0, 1.596], [1.164, -0.391, -0.813], [1.164, 2.018, 0.0]])
_RGB_FROM_YUV_SHIFTED = np.hstack([_RGB_FROM_YUV, -_RGB_FROM_YUV @ [[16.0], [128.0], [128.0]]])


def _packed_to_rgb(pixels: U8, encoding: PackedEncoding) -> U8:
    """Pixels (H, W, channels), the upper byte of each value, as RGB (H, W, 3); contiguous RGB is not copied."""
    if encoding.conversion is None:
        return np.ascontiguousarray(pixels)
    return _convert(pixels[..., 0] if encoding.channels == 1 else pixels, encoding.conversion)


def check_pixels(width: int, height: int, limits: RecordingLimits, topic: str, others: int = 0) -> None:
    """Refuse an image of more pixels than `limits` allow, by itself or with the `others` of its frame."""
    if width * height > limits.max_image_mpx * 1e6:
        raise MessageError(
            f"{topic}: an image of {width} x {height} px, expected at most {limits.max_image_mpx:g} million pixels: "
            "raise limit_scale"
        )
    if others + width * height > limits.max_frame_mpx * 1e6:
        raise MessageError(
            f"{topic}: an image of {width} x {height} px, and {others} in other images of the frame, expected at most "
            f"{limits.max_frame_mpx:g} million pixels in all: raise limit_scale"
        )


def _convert(pixels: U8, conversion: str) -> U8:
    import cv2

    return np.asarray(cv2.cvtColor(pixels, getattr(cv2, conversion)), np.uint8)


RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def decode_any_image(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of a message of any type of images; `others` are the pixels of the frame's other images."""
    image: Image = decode_as("image", message, limits=limits, others=others)
    return image


@decoder
def decode_image(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of a sensor_msgs/Image in one of the encodings that `image_encodings` lists.

    Rows may be padded (`step`). An rgb8 image without padding is a view of the message's bytes.
    """
    import cv2

    image = deserialize_as(message, RAW_IMAGE, limits=limits)
    encoding = image.encoding.strip().lower()
    check_pixels(int(image.width), int(image.height), limits, message.topic, others)
    try:
        if encoding in PACKED:
            rgb = _packed(image, encoding, message.topic)
        elif encoding in PLANAR:
            rgb = _planar(image, encoding, message.topic)
        else:
            known = ", ".join([*PACKED, *PLANAR])
            raise MessageError(f"{message.topic}: encoding {image.encoding!r} is not an image; expected one of {known}")
    except cv2.error as err:
        if is_short_memory(err):
            raise
        reason = one_line(err)
        raise MessageError(f"{message.topic}: {image.encoding} {image.width} x {image.height}: {reason}") from err
    return Image(message.stamp_ns, clean_frame(image.header.frame_id), rgb)


@decoder
def decode_compressed_image(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of a CompressedImage in JPEG, PNG, WebP, AVIF, TIFF or BMP, recognised by its data.

    Of `format` (`jpeg`, or in image_transport's spelling `rgb8; jpeg compressed bgr8`) only the encoding before the
    semicolon matters: image_transport compresses a Bayer mosaic as if it were a grey image. Sixteen bits become
    eight by `>> 8`. An EXIF orientation is ignored: the calibration is for the sensor's own rows and columns.
    """
    compressed = deserialize_as(message, COMPRESSED_IMAGE, limits=limits)
    kind = compressed.format.strip()
    if "compresseddepth" in kind.lower():
        raise MessageError(f"{message.topic}: format {kind!r} holds distances, expected an image: leave it out")
    data, rgb = compressed.data, None
    if size := image_size(data.tobytes()):
        check_pixels(*size, limits, message.topic, others)
        encoding = _encoding_of(kind)
        if encoding is not None and encoding.mosaic:
            rgb = _decode_mosaic(data, encoding)
        else:
            rgb = _imdecode(data, "IMREAD_COLOR_RGB")
    if rgb is None:
        start = bytes(data[:8]).hex(" ") or "nothing"
        raise MessageError(
            f"{message.topic}: {len(data)} bytes of format {kind!r} are not a whole image; "
            f"expected {KINDS} (they start with {start})"
        )
    return Image(message.stamp_ns, clean_frame(compressed.header.frame_id), rgb)


def image_file(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> tuple[bytes, str] | None:
    """The JPEG or PNG in a CompressedImage, and the ending of its name; None if other programs would not show it right.

    The message is one that `decode_compressed_image` decodes.
    """
    if message.channel.msgtype != COMPRESSED_IMAGE:
        return None
    compressed = deserialize_as(message, COMPRESSED_IMAGE, limits=limits)
    encoding = _encoding_of(compressed.format)
    data = compressed.data.tobytes()
    endings = {b"\xff\xd8\xff": ".jpg", b"\x89PNG\r\n": ".png"}
    ending = next((ending for magic, ending in endings.items() if data.startswith(magic)), None)
    return None if ending is None or (encoding is not None and encoding.mosaic) else (data, ending)


def _encoding_of(kind: str) -> PackedEncoding | None:
    return PACKED.get(kind.split(";")[0].strip().lower())


def _packed(image: Any, encoding: str, topic: str) -> U8:
    layout = PACKED[encoding]
    height, width, step = int(image.height), int(image.width), int(image.step)
    _check_size(image, topic, least=3 if layout.mosaic else 1)
    if width % layout.pixels_per_group:
        raise MessageError(f"{topic}: {encoding} needs an even width, found {width} px")
    pixel_bytes = layout.channels * layout.depth_bytes
    _check_bytes(image, topic, row_bytes=width * pixel_bytes, rows=height)
    upper = layout.depth_bytes - 1 if not image.is_bigendian else 0
    pixels: U8 = np.ndarray(
        (height, width, layout.channels), np.uint8, image.data, upper, (step, pixel_bytes, layout.depth_bytes)
    )
    return _packed_to_rgb(pixels, layout)


def _planar(image: Any, encoding: str, topic: str) -> U8:
    """Planes in rows of `step` bytes as RGB; nv12 and nv21 have even width and height."""
    height, width, step = int(image.height), int(image.width), int(image.step)
    _check_size(image, topic, least=1)
    if encoding != "nv24" and (width % 2 or height % 2):
        raise MessageError(f"{topic}: {encoding} needs an even width and height, found {width} x {height} px")
    rows, conversion = height * 3 if encoding == "nv24" else height * 3 // 2, PLANAR[encoding]
    _check_bytes(image, topic, row_bytes=width, rows=rows)
    if conversion is not None:
        return _convert(np.ndarray((rows, width), np.uint8, image.data, 0, (step, 1)), conversion)
    import cv2

    luma: U8 = np.ndarray((height, width, 1), np.uint8, image.data, 0, (step, 1, 1))
    chroma: U8 = np.ndarray((height, width, 2), np.uint8, image.data, height * step, (2 * step, 2, 1))
    return np.asarray(cv2.transform(np.concatenate([luma, chroma], -1), _RGB_FROM_YUV_SHIFTED), np.uint8)


def _check_size(image: Any, topic: str, *, least: int) -> None:
    if image.width < least or image.height < least:
        raise MessageError(
            f"{topic}: an image of {image.width} x {image.height} px in {image.encoding}; "
            f"expected {least} x {least} px or more"
        )


def _check_bytes(image: Any, topic: str, *, row_bytes: int, rows: int) -> None:
    step, found = int(image.step), len(image.data)
    if step < row_bytes or (rows - 1) * step + row_bytes > found:
        raise MessageError(
            f"{topic}: {image.encoding} of {image.width} x {image.height} px has {rows} rows of {row_bytes} bytes or "
            f"more, found a step of {step} bytes and {found} bytes of data"
        )


def _decode_mosaic(data: U8, encoding: PackedEncoding) -> U8 | None:
    grey = _imdecode(data, "IMREAD_ANYCOLOR")
    if grey is None or min(grey.shape[:2]) < 3:
        return None
    if grey.ndim == 3:  # some drivers keep the sensor's encoding after demosaicing
        return np.ascontiguousarray(grey[..., ::-1])
    return _packed_to_rgb(grey[..., None], encoding)


def _imdecode(data: U8, colours: str) -> U8 | None:
    """The image in 8 bits, or None if it cannot be decoded."""
    import cv2

    try:
        image = cv2.imdecode(data, getattr(cv2, colours) | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as err:  # more pixels than OpenCV allows
        if is_short_memory(err):
            raise
        return None
    return None if image is None else np.asarray(image, np.uint8)
