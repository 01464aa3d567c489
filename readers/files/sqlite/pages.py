"""Pages of a database that SQLite leaves out or invents without a word (https://www.sqlite.org/fileformat2.html).

SQLite takes a write-ahead log to end at the first page whose checksum is wrong, ignores a rollback journal whose first
bytes are wrong, and reads zeros for the missing part of the last page.
"""

from pathlib import Path
from typing import BinaryIO, NamedTuple

DATABASE_HEADER_BYTES = 100
PAGE_BYTES = frozenset(1 << n for n in range(9, 17))

JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
HEADER_BYTES, FRAME_HEADER_BYTES = 32, 24
"""Bytes of the header of a write-ahead log, and of each page in it."""

BLOCK_BYTES = 1 << 20


class PageCount(NamedTuple):
    """Pages of a database.

    Attributes:
        page_bytes: Size of a page in bytes.
        whole: Whole pages that the file has.
        expected: Pages that it should have; 0 if an old SQLite wrote it, which did not count them.
        rest: Bytes of the file behind the last whole page.
    """

    page_bytes: int
    whole: int
    expected: int
    rest: int


def count_pages(stream: BinaryIO) -> PageCount:
    """The pages of a database.

    Raises:
        EOFError: the file ends inside its header.
        ValueError: its header is not that of a database.
    """
    file_bytes = stream.seek(0, 2)
    stream.seek(0)
    header = stream.read(DATABASE_HEADER_BYTES)
    if len(header) < DATABASE_HEADER_BYTES:
        raise EOFError(f"expected {DATABASE_HEADER_BYTES} bytes of a database's header, found {len(header)}")
    size = int.from_bytes(header[16:18], "big")
    size = 1 << 16 if size == 1 else size
    if size not in PAGE_BYTES:
        raise ValueError(f"expected a power of two as the size of pages, found {size}")
    is_counted = header[92:96] == header[24:28]  # the count is that of the last change
    expected = int.from_bytes(header[28:32], "big") if is_counted else 0
    return PageCount(size, file_bytes // size, expected, file_bytes % size)


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
    """The part of a journal that SQLite could not apply, in words; empty if it applied all.

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
    return f"{pages} pages of {journal.name} cannot be applied: they are damaged or were not committed"


def _unapplied_pages(stream: BinaryIO, applied: int) -> int:
    """Pages of this log behind those that SQLite has applied: each has the salts of the first one in its header."""
    stream.seek(0)
    head = stream.read(HEADER_BYTES + FRAME_HEADER_BYTES)
    salts = head[HEADER_BYTES + 8 : HEADER_BYTES + 16]
    if len(salts) < 8:
        return 0
    stream.seek(HEADER_BYTES + applied * (FRAME_HEADER_BYTES + int.from_bytes(head[8:12], "big")))
    pages, end = 0, b""
    while block := stream.read(BLOCK_BYTES):
        pages += (end + block).count(salts)
        end = block[-len(salts) + 1 :]
    return pages
