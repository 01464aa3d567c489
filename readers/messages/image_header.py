"""Width and height of a compressed image, read from its header before anything is decoded.

A file of a few kilobytes can claim a billion pixels, and OpenCV allocates them at once.
"""

import struct
import warnings
from functools import cache
from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # Pillow is imported when a picture is looked at, and of its formats only those that come
    from PIL.ImageFile import ImageFile

KINDS = "JPEG, PNG, WebP, AVIF, TIFF or BMP"

MAX_SCANS = 100
"""Scans of a progressive JPEG: encoders make a dozen, and each goes over all pixels."""

JPEG_HEAD_BYTES = 1 << 20
"""Thumbnails and colour profiles before a JPEG's frame take a few hundred kilobytes; Pillow skips junk byte by byte."""

JPEG, TIFF = "Jpeg", "Tiff"

# By Pillow's names. Not `Image.open`, whose own limit of pixels is global to the process.
_FORMATS = (
    (b"\xff\xd8\xff", 0, JPEG),
    (b"\x89PNG\r\n\x1a\n", 0, "Png"),
    (b"WEBP", 8, "WebP"),
    (b"ftypavi", 4, "Avif"),
    (b"II*\0", 0, TIFF),
    (b"MM\0*", 0, TIFF),
    (b"BM", 0, "Bmp"),
)

warnings.filterwarnings("ignore", module=r"PIL\.")  # about damaged metadata, which are not read

Size = tuple[int, int]


def image_size(data: bytes) -> Size | None:
    """Width and height in pixels; None if the data are not an image of `KINDS`, or a damaged one."""
    name = next((name for magic, at, name in _FORMATS if data.startswith(magic, at)), None)
    if name is None or (name == JPEG and data.count(b"\xff\xda") > MAX_SCANS):
        return None
    plugin = _plugin(name)
    try:
        image = plugin(BytesIO(data[:JPEG_HEAD_BYTES] if name == JPEG else data))
        if name == TIFF:
            return _tiff_size(image, data)
        size = image.size
        image.verify()  # all chunks of a PNG are there: OpenCV allocates what a chunk claims
    except MemoryError:
        raise
    except Exception:  # damaged data raise errors of many types in Pillow's parsers
        return None
    return size


@cache
def _plugin(name: str) -> "type[ImageFile]":
    found: type[ImageFile] = getattr(import_module(f"PIL.{name}ImagePlugin"), f"{name}ImageFile")
    return found


def _tiff_size(image: "ImageFile", data: bytes) -> Size | None:
    """Size of the image or of its tiles, whichever is larger, before any rotation.

    None unless Pillow took every field: it skips those that claim more data than the file holds, but OpenCV's libtiff
    copies them.
    """
    from PIL.TiffImagePlugin import IMAGELENGTH, IMAGEWIDTH, TILELENGTH, TILEWIDTH, TiffImageFile

    assert isinstance(image, TiffImageFile)
    tags, order = image.tag_v2, "<" if data[:2] == b"II" else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (fields,) = struct.unpack_from(f"{order}H", data, directory)
    if len(tags) != fields:
        return None
    return max(tags[IMAGEWIDTH], int(tags.get(TILEWIDTH, 0))), max(tags[IMAGELENGTH], int(tags.get(TILELENGTH, 0)))
