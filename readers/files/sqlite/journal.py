"""What SQLite has yet to apply to a database, and what of it SQLite leaves out without a word.

SQLite takes a write-ahead log to end at the first page whose checksum is wrong, and a rollback journal whose first
bytes are wrong for none at all (https://www.sqlite.org/fileformat2.html, 3 and 4).
"""

import struct
from itertools import islice
from pathlib import Path
from typing import BinaryIO

__all__ = ["journals_of", "unapplied"]

JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
WAL_MAGICS = {0x377F0682: "<", 0x377F0683: ">"}
"""With the byte order of the checksums."""

WAL_HEADER = struct.Struct(">IIIIIIII")  # magic, version, page size, sequence, two salts, two checksums
FRAME_HEADER = struct.Struct(">IIIIII")  # page, size of the database if it ends a transaction, two salts, two checksums

MAX_CHECKED = 10_000
"""Pages of a transaction that was not finished whose checksums are computed."""


def journals_of(path: Path) -> list[Path]:
    """The write-ahead log of a database, or the rollback journal of a half-done write; mostly none."""
    wal, journal = (path.with_name(path.name + suffix) for suffix in ("-wal", "-journal"))
    found = [wal] if wal.is_file() and wal.stat().st_size else []
    if journal.is_file():
        with journal.open("rb") as stream:
            if any(stream.read(len(JOURNAL_MAGIC))):  # zeros: the write was finished (journal_mode=PERSIST)
                found.append(journal)
    return found


def unapplied(journal: Path, folder: Path, applied: int) -> str:
    """What of a journal SQLite could not apply, in words; empty if it applied all.

    Args:
        journal: The journal as it was found.
        folder: Where SQLite has completed a copy of the database.
        applied: Pages of the write-ahead log that it has applied; negative if it used none.
    """
    with journal.open("rb") as stream:
        if not journal.name.endswith("-wal"):
            left = folder / journal.name
            is_known = stream.read(len(JOURNAL_MAGIC)) == JOURNAL_MAGIC
            is_left = left.is_file() and left.stat().st_size > 0
            return "" if is_known and not is_left else f"{journal.name} cannot be applied: a write was left half-done"
        pages = _unapplied_pages(stream, max(applied, 0))
    if not pages:
        return ""
    return f"{pages} pages of {journal.name} cannot be applied: it is damaged, and what they hold is missing"


def _unapplied_pages(stream: BinaryIO, applied: int) -> int:
    size = stream.seek(0, 2)
    stream.seek(0)
    header = stream.read(WAL_HEADER.size)
    if len(header) < WAL_HEADER.size:
        return 0
    magic, _, page_bytes, _, *salts, first, second = WAL_HEADER.unpack(header)
    frame_bytes = FRAME_HEADER.size + page_bytes
    order = WAL_MAGICS.get(magic)
    if order is None or _checksum(order, header[:24], (0, 0)) != (first, second):
        return max((size - WAL_HEADER.size) // max(frame_bytes if page_bytes <= 65536 else 4096, 512), 1)
    count: int = (size - WAL_HEADER.size) // frame_bytes
    if applied:
        stream.seek(WAL_HEADER.size + (applied - 1) * frame_bytes)
        *_, first, second = FRAME_HEADER.unpack(stream.read(FRAME_HEADER.size))
    sums = first, second
    for number in islice(range(applied, count), MAX_CHECKED):
        stream.seek(WAL_HEADER.size + number * frame_bytes)
        frame = stream.read(frame_bytes)
        _, _, *own_salts, first, second = FRAME_HEADER.unpack_from(frame)
        sums = _checksum(order, frame[:8] + frame[FRAME_HEADER.size :], sums)
        if own_salts == salts and sums == (first, second):
            continue
        salts_left = (_salts(stream, WAL_HEADER.size + other * frame_bytes) for other in range(number, count))
        is_of_older_log = own_salts[0] != salts[0] and own_salts[1] != salts[1]
        return 0 if is_of_older_log and salts not in salts_left else count - number
    return 0


def _salts(stream: BinaryIO, position: int) -> list[int]:
    stream.seek(position)
    return list(FRAME_HEADER.unpack(stream.read(FRAME_HEADER.size))[2:4])


def _checksum(order: str, content: bytes, sums: tuple[int, int]) -> tuple[int, int]:
    first, second = sums
    words = struct.unpack(f"{order}{len(content) // 4}I", content[: len(content) // 4 * 4])
    for one, two in zip(words[::2], words[1::2], strict=False):
        first = (first + one + second) & 0xFFFFFFFF
        second = (second + two + first) & 0xFFFFFFFF
    return first, second
