"""Decodes sensor_msgs/Image; `decode_any_image` also CompressedImage."""

from typing import Any

import numpy as np

from pipeline.core.arrays import U8
from pipeline.core.errors import MessageError, is_short_memory
from pipeline.core.images import Image
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from pipeline.core.text import one_line
from readers.messages.boundary.decoding import decoder
from readers.messages.compressed_image import COMPRESSED_IMAGE, decode_compressed_image
from readers.messages.deserialize import deserialize_as
from readers.messages.image_encodings import PACKED, PLANAR, check_pixels, packed_to_rgb, planar_rows, planar_to_rgb
from readers.messages.tf import clean_frame

__all__ = ["COMPRESSED_IMAGE", "RAW_IMAGE", "decode_any_image", "decode_image"]

RAW_IMAGE = "sensor_msgs/msg/Image"


@decoder
def decode_any_image(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS, others: int = 0) -> Image:
    """The image of an Image or CompressedImage; `others` are the pixels of the frame's other images.

    Raises:
        MessageError: the message is of another type or holds no image.
    """
    if message.channel.msgtype == COMPRESSED_IMAGE:
        return decode_compressed_image(message, limits=limits, others=others)
    if message.channel.msgtype == RAW_IMAGE:
        return decode_image(message, limits=limits, others=others)
    raise MessageError(f"{message.topic}: expected {RAW_IMAGE} or {COMPRESSED_IMAGE}, found {message.channel.msgtype}")


@decoder
def decode_image(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS, others: int = 0) -> Image:
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
