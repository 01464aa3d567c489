"""sensor_msgs/CompressedImage to `Image`."""

import cv2
import numpy as np

from pipeline.core.arrays import U8
from pipeline.core.errors import MessageError
from pipeline.core.images import Image
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.messages.deserialize import deserialize_as
from readers.messages.image_encodings import PACKED, check_pixels, demosaic
from readers.messages.image_header import KINDS, image_size
from readers.messages.tf import clean_frame

__all__ = ["COMPRESSED_IMAGE", "decode_compressed_image"]

COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"


def decode_compressed_image(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """The image of a CompressedImage: JPEG, PNG, WebP, AVIF, TIFF or BMP; the data tell which.

    Of `format` (`jpeg`, or in image_transport's spelling `rgb8; jpeg compressed bgr8`) only the encoding before the
    semicolon matters: image_transport compresses a Bayer mosaic as if it were a grey image. Sixteen bits become
    eight by `>> 8`. An EXIF orientation is ignored: the calibration belongs to the sensor's own rows and columns.

    Raises:
        MessageError: not a CompressedImage, broken data, more pixels than `limits` allow, or a compressed depth map.
    """
    compressed = deserialize_as(message, COMPRESSED_IMAGE)
    kind = compressed.format.strip()
    if "compresseddepth" in kind.lower():
        raise MessageError(f"{message.topic}: format {kind!r} holds distances, expected an image: leave it out")
    size = image_size(compressed.data.tobytes())
    if size is not None:
        check_pixels(*size, limits, message.topic)
    source = kind.split(";")[0].strip().lower()
    is_mosaic = source in PACKED and PACKED[source].mosaic
    rgb = None
    if size is not None:
        data = compressed.data
        rgb = _decode_mosaic(data, source) if is_mosaic else _imdecode(data, cv2.IMREAD_COLOR_RGB)
    if rgb is None:
        start = bytes(compressed.data[:8]).hex(" ") or "nothing"
        raise MessageError(
            f"{message.topic}: {len(compressed.data)} bytes of format {kind!r} are no whole image; "
            f"expected {KINDS} (they start with {start})"
        )
    return Image(message.stamp_ns, clean_frame(compressed.header.frame_id), rgb)


def _decode_mosaic(data: U8, encoding: str) -> U8 | None:
    grey = _imdecode(data, cv2.IMREAD_ANYCOLOR)
    if grey is None or min(grey.shape[:2]) < 3:
        return None
    if grey.ndim == 3:  # some drivers name the sensor's encoding although they took the mosaic apart
        return np.ascontiguousarray(grey[..., ::-1])
    return demosaic(grey, encoding)


def _imdecode(data: U8, colour: int) -> U8 | None:
    """The image in 8 bits, or None where there is none."""
    if not len(data):
        return None
    try:
        image = cv2.imdecode(data, colour | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # more pixels than OpenCV allows
        return None
    return None if image is None else np.asarray(image, np.uint8)
