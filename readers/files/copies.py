"""Files that are not read in their place: what is read of them is a copy in a temporary folder, with its path."""

import os
import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, NamedTuple

import zstandard

from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.damage import Losses


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder in the system's temporary folder; removed at the end of the block, or when a signal ends the run."""
    with (
        TemporaryDirectory(prefix="lidcam-", ignore_cleanup_errors=True) as folder,
        undone_at_once(partial(shutil.rmtree, folder, ignore_errors=True)),
    ):
        yield Path(folder)


PIECE_BYTES = 1 << 20
DISK_RESERVE = 1 << 28
"""Bytes of the temporary folder's disk that are left free."""

DATABASE_HEADER_BYTES = 100
PAGE_BYTES = frozenset(1 << n for n in range(9, 17))
JOURNAL_MAGIC_BYTES = 8
LOG_HEADER_BYTES, LOG_PAGE_HEADER_BYTES = 32, 24


def unpacked(
    path: Path, packed: BinaryIO, stack: ExitStack, losses: Losses, limits: RecordingLimits
) -> tuple[Path, BinaryIO]:
    """The content of a zstd-compressed file (rosbag2's compression mode `file`), as a file in a temporary folder.

    What comes before damage is used.
    """
    folder = stack.enter_context(temporary_folder())
    copy = folder / path.with_suffix("").name
    with copy.open("wb") as stream:
        with losses.guard() as damage:
            content = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True, closefd=False)
            largest = limits.max_unpacked_bytes(os.fstat(packed.fileno()).st_size)
            left = min(largest, shutil.disk_usage(folder).free - DISK_RESERVE)
            while piece := content.read(PIECE_BYTES):
                left -= len(piece)
                if left < 0:
                    raise RecordingError(
                        f"{path}: unpacks to more than {stream.tell()} bytes: raise limit_scale, "
                        f"or free space in {folder.parent}"
                    )
                stream.write(piece)
        if damage.error:
            losses.note(stream.tell(), f"the file does not unpack further ({damage.reason})")
    return copy, stack.enter_context(copy.open("rb"))


class PageCount(NamedTuple):
    """Pages of a database (https://www.sqlite.org/fileformat2.html)."""

    page_bytes: int  # Size of a page in bytes
    whole: int  # Whole pages that the file has
    expected: int  # Pages that it should have; 0 if an old SQLite wrote it, which did not count them
    rest: int  # Bytes of the file behind the last whole page


def count_pages(stream: BinaryIO) -> PageCount:
    """The pages of a database."""
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
            if any(stream.read(JOURNAL_MAGIC_BYTES)):  # zeros: the write was finished (journal_mode=PERSIST)
                found.append(journal)
    return found


def completed(
    path: Path, stream: BinaryIO, journals: Sequence[Path], stack: ExitStack, losses: Losses
) -> tuple[Path, BinaryIO]:
    """A copy of a database that its recorder did not close, completed by SQLite from the journals."""
    folder = stack.enter_context(temporary_folder())
    copy = folder / path.name
    _copy(stream, copy)
    for file in journals:
        shutil.copyfile(file, folder / file.name)
    names = ", ".join(journal.name for journal in journals)
    with losses.guard() as damage, closing(sqlite3.connect(copy)) as database:
        database.execute("SELECT count(*) FROM sqlite_master").fetchall()
        ((page_bytes,),) = database.execute("PRAGMA page_size")
        ((_, applied, _),) = database.execute("PRAGMA wal_checkpoint(PASSIVE)")
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        losses.note(0, f"the recorder did not close it; completed from {names} in a copy", messages=0)
        logged = (journals[0].stat().st_size - LOG_HEADER_BYTES) // (page_bytes + LOG_PAGE_HEADER_BYTES)
        if journals[0].name.endswith("-wal") and logged > max(applied, 0):
            losses.note(
                0, f"{logged - max(applied, 0)} pages of {names} are damaged, not committed, or of an older log"
            )
    if damage.error:
        losses.note(0, f"the recorder did not close it, and {names} cannot be applied ({damage.reason})")
    for journal in journals:
        (folder / journal.name).unlink(missing_ok=True)
    return copy, stack.enter_context(copy.open("rb"))


def _copy(stream: BinaryIO, copy: Path) -> None:
    stream.seek(0)
    with copy.open("wb") as target:
        shutil.copyfileobj(stream, target)


def whole_pages(content: Path, stream: BinaryIO, stack: ExitStack) -> tuple[Path, BinaryIO]:
    """A database, or a copy without its last page if it ends inside that: SQLite would read zeros for the rest."""
    pages = count_pages(stream)
    if not pages.rest or pages.whole >= pages.expected > 0:
        return content, stream
    copy = stack.enter_context(temporary_folder()) / content.name
    _copy(stream, copy)
    whole = stack.enter_context(copy.open("r+b"))
    whole.truncate(pages.whole * pages.page_bytes)
    return copy, whole
