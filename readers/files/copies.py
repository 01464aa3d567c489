"""Files that are not read in their place: what is read of them is a copy in a temporary folder, with its path."""

import os
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import BinaryIO

import zstandard

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.recording import LimitsConfig
from lidcam.readers.files.damage import Losses
from lidcam.readers.files.sqlite.pages import count_pages, unapplied
from lidcam.readers.files.temporary import temporary_folder

PIECE = 1 << 20
DISK_RESERVE = 1 << 28
"""Bytes of the temporary folder's disk that are left free."""


def unpacked(
    path: Path, packed: BinaryIO, stack: ExitStack, losses: Losses, limits: LimitsConfig
) -> tuple[Path, BinaryIO]:
    """The content of a zstd-compressed file (rosbag2's compression mode `file`), as a file in a temporary folder.

    Args:
        path: The file.
        packed: Its bytes.
        stack: Removes the folder.
        losses: Collects where the file is damaged; the content before is used.
        limits: How much it may unpack to.

    Raises:
        RecordingError: it unpacks to more, or to more than the temporary folder has space for.
    """
    folder = stack.enter_context(temporary_folder())
    copy = folder / path.with_suffix("").name
    with copy.open("wb") as stream:
        with losses.guard() as damage:
            content = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True, closefd=False)
            largest = limits.max_unpacked_bytes(os.fstat(packed.fileno()).st_size)
            left = min(largest, shutil.disk_usage(folder).free - DISK_RESERVE)
            while piece := content.read(PIECE):
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
        ((_, applied, _),) = database.execute("PRAGMA wal_checkpoint(PASSIVE)")
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        losses.note(0, f"the recorder did not close it; completed from {names} in a copy", messages=0)
        for reason in filter(None, (unapplied(journal, folder, applied) for journal in journals)):
            losses.note(0, reason)
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
