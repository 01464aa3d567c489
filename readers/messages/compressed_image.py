"""Decodes sensor_msgs/CompressedImage."""

import numpy as np

from pipeline.core.arrays import U8
from pipeline.core.errors import MessageError, is_short_memory
from pipeline.core.images import Image
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.messages.boundary.decoding import decoder
from readers.messages.deserialize import deserialize_as
from readers.messages.image_encodings import PACKED, PackedEncoding, check_pixels, packed_to_rgb
from readers.messages.image_header import KINDS, image_size
from readers.messages.tf import clean_frame

__all__ = ["COMPRESSED_IMAGE", "decode_compressed_image"]

COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"


@decoder
def decode_compressed_image(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS, others: int = 0) -> Image:
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
