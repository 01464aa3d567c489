"""Decodes sensor_msgs/Image and sensor_msgs/CompressedImage."""

from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.image_encodings import (
    PACKED,
    PLANAR,
    PackedEncoding,
    check_pixels,
    packed_to_rgb,
    planar_rows,
    planar_to_rgb,
)
from lidcam.readers.messages.image_header import KINDS, image_size
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.messages.tf import clean_frame

RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def decode_any_image(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of a message of any type of images; `others` are the pixels of the frame's other images.

    Raises:
        MessageError: the message is of another type or holds no image.
    """
    image: Image = decode_as("image", message, limits=limits, others=others)
    return image


@decoder
def decode_image(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of a sensor_msgs/Image in one of the encodings that `image_encodings` lists.

    Rows may be padded (`step`). An rgb8 image without padding is a view of the message's bytes.

    Raises:
        MessageError: not an Image, an encoding of something else, sizes that do not fit the data, or more pixels than
            `limits` allow.
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

    Raises:
        MessageError: not a CompressedImage, damaged data, more pixels than `limits` allow, or a compressed depth map.
    """
    compressed = deserialize_as(message, COMPRESSED_IMAGE, limits=limits)
    kind = compressed.format.strip()
    if "compresseddepth" in kind.lower():
        raise MessageError(f"{message.topic}: format {kind!r} holds distances, expected an image: leave it out")
    data, rgb = compressed.data, None
    if size := image_size(data.tobytes()):
        check_pixels(*size, limits, message.topic, others)
        encoding = PACKED.get(kind.split(";")[0].strip().lower())
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
    return packed_to_rgb(pixels, layout)


def _planar(image: Any, encoding: str, topic: str) -> U8:
    height, width, step = int(image.height), int(image.width), int(image.step)
    _check_size(image, topic, least=1)
    if encoding != "nv24" and (width % 2 or height % 2):
        raise MessageError(f"{topic}: {encoding} needs an even width and height, found {width} x {height} px")
    _check_bytes(image, topic, row_bytes=width, rows=planar_rows(encoding, height))
    return planar_to_rgb(image.data, encoding, height=height, width=width, step=step)


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
    return packed_to_rgb(grey[..., None], encoding)


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
