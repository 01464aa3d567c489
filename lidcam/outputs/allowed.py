"""Outputs must never replace an input of the run, or a file that lidcam did not write itself.

Its own files are recognised by the marks that they carry (`lidcam.writers.outputs.marks`). An unfinished or damaged
file is not recognised; one that cannot be read raises OSError.
"""

import os
import re
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from rosbags.rosbag1 import Reader

from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.location import Location
from lidcam.writers.outputs import marks
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import is_unchanged_text
from lidcam.writers.outputs.work_folder import folder_prefix
from lidcam.writers.tables.writer import CSV_HEADER

SQLITE_SUFFIXES = ("-journal", "-wal", "-shm")
"""Endings of files beside a database that are a part of it."""

MAX_TEXT_BYTES = 16 << 20
HEAD_BYTES = 1 << 12
_NAME = bytes([len(marks.APPLICATION)]) + marks.APPLICATION.encode()
RRD_STORE = re.compile(rb"\x12\x20[0-9a-f]{32}\x1a.\n" + re.escape(_NAME))
"""Recording id and application id in the first message of an .rrd, as protobuf."""


def check_no_input(outputs: Sequence[Path], inputs: Iterable[Location]) -> None:
    """Check that no output is an input, by its name or by a link, a part of one, or what a killed run left."""
    sources = [path for path in inputs if isinstance(path, Path)]
    for output in outputs:
        with output_errors(output):
            for source in sources:
                _check_one(output, source)


def _check_one(output: Path, source: Path) -> None:
    try:
        target, resolved = output.resolve(), source.resolve()
    except (ValueError, RuntimeError):  # no path at all: whoever opens it will say so
        return
    is_same = target == resolved or (target.exists() and source.exists() and target.samefile(source))
    is_metadata = resolved in target.parents and target.name == "metadata.yaml"
    is_around = target in resolved.parents and target.exists()
    is_journal = target in [resolved.with_name(f"{resolved.name}{suffix}") for suffix in SQLITE_SUFFIXES]
    if is_same or is_metadata or is_around or is_journal:
        raise OutputError(f"{output}: is an input of this run ({source}), or a part of one; choose another name")
    prefix = folder_prefix(target)
    if any(folder.parent == target.parent and folder.name.startswith(prefix) for folder in resolved.parents):
        raise OutputError(
            f"{output}: the input {source} is what a killed run has left of this output; move it elsewhere first"
        )


def is_marked_mcap(path: Path, mark: str) -> bool:
    """Whether a file is an MCAP of lidcam that was closed and has a metadata record of this name."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        try:
            reader = SeekingReader(file)
            summary = reader.get_summary()
            is_own = reader.get_header().library == marks.LIBRARY
        except (McapError, struct.error, ValueError, OSError):
            return False
    return is_own and summary is not None and mark in {index.name for index in summary.metadata_indexes}


def is_own_mcap(path: Path) -> bool:
    """Whether a file is a result."""
    return is_marked_mcap(path, marks.RESULT)


def is_own_rerun(path: Path) -> bool:
    """Whether a file is a Rerun recording of lidcam."""
    head = _head(path, HEAD_BYTES)
    return head.startswith(b"RRF2") and RRD_STORE.search(head) is not None


def is_own_csv(path: Path) -> bool:
    """Whether a file is a table of objects: its first line has exactly their columns, which is its only mark."""
    return _head(path, HEAD_BYTES).startswith(CSV_HEADER.encode())


def is_own_page(path: Path) -> bool:
    """Whether a file is a page about a result of lidcam."""
    return marks.PAGE.encode() in _head(path, HEAD_BYTES)


def is_own_parquet(path: Path) -> bool:
    """Whether a file is a Parquet table of objects of lidcam that was closed: its metadata come last.

    Read without pyarrow, which starts threads: a run forks its workers later.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - MAX_TEXT_BYTES, 0))
        tail = file.read()
    return tail.endswith(b"PAR1") and marks.OBJECTS.encode() in tail[-8 - int.from_bytes(tail[-8:-4], "little") :]


def is_own_matches(path: Path) -> bool:
    """Whether a folder has images of cameras and nothing else, or nothing at all."""
    return path.is_dir() and all(
        not file.is_symlink() and marks.MATCHES.encode() in _head(file, HEAD_BYTES) for file in path.iterdir()
    )


def is_own_film(path: Path) -> bool:
    """Whether a file is a film of a result: its comment stands before the images."""
    head = _head(path, MAX_TEXT_BYTES)
    return head[4:8] == b"ftyp" and marks.FILM.encode() in head


def _is_simulated(path: Path) -> bool:
    if is_marked_mcap(path, marks.SIMULATED):
        return True
    if not path.is_file():
        return False
    try:
        with Reader(path) as reader:
            return {getattr(one.ext, "callerid", None) for one in reader.connections} == {marks.BAG_CALLER}
    except Exception:  # whatever the libraries raise: it is not as lidcam left it
        return False


def _head(path: Path, size: int) -> bytes:
    """The first bytes of a file; none of anything else."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(size)


@dataclass(frozen=True, slots=True)
class Replaceable:
    """Files that a command may replace without --overwrite: its own."""

    is_own: Callable[[Path], bool]  # Whether the command wrote the file or folder that stands at a path
    otherwise: str  # Error message for a file that it did not write
    only_own: bool = False  # Whether --overwrite does not replace others either: a folder may hold anything


TEXT = Replaceable(
    lambda path: is_unchanged_text(_head(path, MAX_TEXT_BYTES).decode(errors="replace")),
    "exists and is not as this version writes it (edited, or written by an earlier version)",
)
"""Layouts, JSON, drafts of a rig."""

REPAIRED = Replaceable(lambda path: is_marked_mcap(path, marks.REPAIRED), "exists and was not written by --repair")
PAGE = Replaceable(is_own_page, "exists and is no page about a result")
SIMULATED = Replaceable(_is_simulated, "exists and is no simulated recording")


OVERWRITING = "choose another name, or replace it with --overwrite, in Python overwrite=True"
"""Remedy for a file that is in the way."""


def check_replaced(replaceable: Callable[[Path], Replaceable], *, overwrite: bool) -> Callable[[Path], None]:
    """A check of old outputs, for `OutputTransaction`; with `overwrite` other files may be replaced, too."""

    def check(path: Path) -> None:
        with output_errors(path):
            allowed = replaceable(path)
            if allowed.only_own and not allowed.is_own(path):
                raise OutputError(f"{path}: {allowed.otherwise}; choose another name")
            if overwrite:
                return
            if not allowed.is_own(path):
                raise OutputError(f"{path}: {allowed.otherwise}; {OVERWRITING}")
            if not os.access(path, os.W_OK):
                raise OutputError(f"{path}: is write-protected; {OVERWRITING}")

    return check
