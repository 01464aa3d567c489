"""Width and height of a compressed image, read from its header before anything is decoded.

A file of a few kilobytes can claim a billion pixels, and OpenCV allocates them at once.
"""

import warnings
from importlib import import_module
from io import BytesIO

KINDS = "JPEG, PNG, WebP, AVIF, TIFF or BMP"

# By Pillow's names, each imported when it comes. Not `Image.open`, whose own limit of pixels is global to the process.
_FORMATS = (
    (b"\xff\xd8\xff", 0, "Jpeg"),
    (b"\x89PNG\r\n\x1a\n", 0, "Png"),
    (b"WEBP", 8, "WebP"),
    (b"ftypavi", 4, "Avif"),
    (b"II*\0", 0, "Tiff"),
    (b"MM\0*", 0, "Tiff"),
    (b"BM", 0, "Bmp"),
)

warnings.filterwarnings("ignore", module=r"PIL\.")  # about damaged metadata, which are not read


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels; None if the data are not an image of `KINDS`, or a damaged one."""
    name = next((name for magic, at, name in _FORMATS if data.startswith(magic, at)), None)
    if name is None:
        return None
    try:
        image = getattr(import_module(f"PIL.{name}ImagePlugin"), f"{name}ImageFile")(BytesIO(data))
        width, height = image.size
        image.verify()  # all chunks of a PNG are there: OpenCV allocates what a chunk claims
    except MemoryError:
        raise
    except Exception:  # damaged data raise errors of many types in Pillow's parsers
        return None
    return width, height
