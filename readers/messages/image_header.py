"""Width and height of a compressed image from its first bytes, before anything is unpacked.

A file of a few kilobytes can name an image of a billion pixels, and OpenCV takes the memory for it at once. Sources:
ITU-T T.81 B.2 (JPEG), PNG 11.2.1 and 5.2, RFC 9649 (WebP), ISO/IEC 23008-12 6.5.3 (AVIF), TIFF 6.0
section 2, Windows GDI (BMP).
"""

import struct
from collections.abc import Callable

import numpy as np

__all__ = ["KINDS", "image_size"]

KINDS = "JPEG, PNG, WebP, AVIF, TIFF or BMP"

MAX_SEGMENTS = 2000
"""Segments of a JPEG before its frame: thumbnails and colour profiles take a few dozen."""

MAX_SCANS = 100
"""Scans of a progressive JPEG: encoders make a dozen, and each goes over all pixels."""

MAX_CHUNKS = 100_000
"""Chunks of a PNG: encoders put kilobytes in each."""

FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
STANDALONE_MARKERS = frozenset([0x01, *range(0xD0, 0xD9)])
HEAD_BYTES = 1 << 16

MAX_TIFF_FIELDS = 200
"""Fields of a TIFF's first directory: some forty are defined."""

MAX_TIFF_SAMPLES = 4
TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
"""Bytes of one value by its type."""

WIDTH, LENGTH, SAMPLES, TILE_WIDTH, TILE_LENGTH = 256, 257, 277, 322, 323
STRIP_BYTES, TILE_BYTES = 279, 325

Size = tuple[int, int]


def image_size(data: bytes) -> Size | None:
    """Width and height in pixels; None where the data begin as no image of `KINDS` does, or end too soon.

    Where several sizes are named (the parts of an AVIF, the tiles of a TIFF), the largest of each.
    """
    read = next((read for begin, at, read in _READERS if data.startswith(begin, at)), None)
    if read is None:
        return None
    try:
        return read(data)
    except (struct.error, IndexError, KeyError, ValueError):
        return None


def _jpeg(data: bytes) -> Size | None:
    if data.count(b"\xff\xda") > MAX_SCANS:
        return None
    at = 2
    for _ in range(MAX_SEGMENTS):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
        elif marker in STANDALONE_MARKERS:
            at += 2
        elif marker in FRAME_MARKERS:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _png(data: bytes) -> Size | None:
    kind, width, height = struct.unpack_from(">4sII", data, 12)
    if kind != b"IHDR":
        return None
    at = 8
    for _ in range(MAX_CHUNKS):  # OpenCV takes as much memory as a chunk says before it looks for its data
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if kind == b"IEND":
            break
    return (width, height) if at <= len(data) else None


def _webp(data: bytes) -> Size | None:
    kind = data[12:16]
    if kind == b"VP8X":
        number = int.from_bytes(data[24:30], "little")
        return (number & 0xFFFFFF) + 1, (number >> 24) + 1
    if kind == b"VP8L":
        (number,) = struct.unpack_from("<I", data, 21)
        return (number & 0x3FFF) + 1, (number >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


def _avif(data: bytes) -> Size | None:
    head = data[:HEAD_BYTES]
    widths, heights = [0], [0]
    at = head.find(b"ispe")
    while at >= 0:
        width, height = struct.unpack_from(">II", head, at + 8)
        widths.append(width)
        heights.append(height)
        at = head.find(b"ispe", at + 4)
    return (max(widths), max(heights)) if len(widths) > 1 else None


def _bmp(data: bytes) -> Size | None:
    (size,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if size == 12 else "<ii", data, 18)
    return abs(width), abs(height)


def _tiff(data: bytes) -> Size | None:
    """Of the first directory; libraries take memory by its other numbers, too, so that these have to fit the file."""
    order = "<" if data[:2] == b"II" else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (fields,) = struct.unpack_from(f"{order}H", data, directory)
    if fields > MAX_TIFF_FIELDS:
        return None
    values: dict[int, int] = {}
    for at in range(directory + 2, directory + 2 + 12 * fields, 12):
        tag, kind, count = struct.unpack_from(f"{order}HHI", data, at)
        size = TIFF_SIZES.get(kind, 8) * count
        place = at + 8 if size <= 4 else struct.unpack_from(f"{order}I", data, at + 8)[0]
        if place + size > len(data):
            return None
        if tag in (WIDTH, LENGTH, SAMPLES, TILE_WIDTH, TILE_LENGTH, STRIP_BYTES, TILE_BYTES):
            if kind not in (3, 4):  # SHORT, LONG
                return None
            numbers = np.frombuffer(data, f"{order}u{TIFF_SIZES[kind]}", count, place)
            values[tag] = int(numbers.max(initial=0))
    packed = max(values.get(STRIP_BYTES, 0), values.get(TILE_BYTES, 0))
    if packed > len(data) or values.get(SAMPLES, 1) > MAX_TIFF_SAMPLES:
        return None
    return max(values[WIDTH], values.get(TILE_WIDTH, 0)), max(values[LENGTH], values.get(TILE_LENGTH, 0))


_READERS: tuple[tuple[bytes, int, Callable[[bytes], Size | None]], ...] = (
    (b"\xff\xd8\xff", 0, _jpeg),
    (b"\x89PNG\r\n\x1a\n", 0, _png),
    (b"WEBP", 8, _webp),
    (b"ftypavi", 4, _avif),
    (b"II*\0", 0, _tiff),
    (b"MM\0*", 0, _tiff),
    (b"BM", 0, _bmp),
)
