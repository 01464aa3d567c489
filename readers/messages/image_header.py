"""Width and height of a compressed image, read from its header before anything is decoded.

A file of a few kilobytes can claim a billion pixels, and OpenCV allocates them at once.
"""

import struct
import warnings
from io import BytesIO

from PIL.AvifImagePlugin import AvifImageFile
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import IMAGELENGTH, IMAGEWIDTH, TILELENGTH, TILEWIDTH, TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

__all__ = ["KINDS", "image_size"]

KINDS = "JPEG, PNG, WebP, AVIF, TIFF or BMP"

MAX_SCANS = 100
"""Scans of a progressive JPEG: encoders make a dozen, and each goes over all pixels."""

JPEG_HEAD_BYTES = 1 << 20
"""Thumbnails and colour profiles before a JPEG's frame take a few hundred kilobytes; Pillow skips junk byte by byte."""

# Not `Image.open`, whose own limit of pixels is global to the process.
_PLUGINS: tuple[tuple[bytes, int, type[ImageFile]], ...] = (
    (b"\xff\xd8\xff", 0, JpegImageFile),
    (b"\x89PNG\r\n\x1a\n", 0, PngImageFile),
    (b"WEBP", 8, WebPImageFile),
    (b"ftypavi", 4, AvifImageFile),
    (b"II*\0", 0, TiffImageFile),
    (b"MM\0*", 0, TiffImageFile),
    (b"BM", 0, BmpImageFile),
)

warnings.filterwarnings("ignore", module=r"PIL\.")  # about damaged metadata, which are not read

Size = tuple[int, int]


def image_size(data: bytes) -> Size | None:
    """Width and height in pixels; None if the data are not an image of `KINDS`, or a damaged one."""
    plugin = next((plugin for magic, at, plugin in _PLUGINS if data.startswith(magic, at)), None)
    if plugin is None or (plugin is JpegImageFile and data.count(b"\xff\xda") > MAX_SCANS):
        return None
    try:
        image = plugin(BytesIO(data[:JPEG_HEAD_BYTES] if plugin is JpegImageFile else data))
        if isinstance(image, TiffImageFile):
            return _tiff_size(image, data)
        size = image.size
        image.verify()  # all chunks of a PNG are there: OpenCV allocates what a chunk claims
    except MemoryError:
        raise
    except Exception:  # damaged data raise errors of many types in Pillow's parsers
        return None
    return size


def _tiff_size(image: TiffImageFile, data: bytes) -> Size | None:
    """Size of the image or of its tiles, whichever is larger, before any rotation.

    None unless Pillow took every field: it skips those that claim more data than the file holds, but OpenCV's libtiff
    copies them.
    """
    tags, order = image.tag_v2, "<" if data[:2] == b"II" else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (fields,) = struct.unpack_from(f"{order}H", data, directory)
    if len(tags) != fields:
        return None
    return max(tags[IMAGEWIDTH], int(tags.get(TILEWIDTH, 0))), max(tags[IMAGELENGTH], int(tags.get(TILELENGTH, 0)))
