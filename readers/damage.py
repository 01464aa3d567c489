"""The errors of the reading libraries in our words: one line that names the file, the trouble and the remedy.

A damaged file makes the libraries raise nearly anything (lz4 a RuntimeError, bz2 an OSError without number, rosbags
AssertionErrors), so the list is long; what is not in it (AttributeError, NameError...) is a bug, with its traceback.
"""

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml
import zstandard
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError

from pipeline.errors import LidcamError, RecordingError

__all__ = ["LIBRARY_ERRORS", "damaged", "opening"]

LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    ReaderError,
    McapError,
    sqlite3.Error,
    zstandard.ZstdError,
    yaml.YAMLError,
    struct.error,
    OSError,  # also bz2
    EOFError,
    RuntimeError,  # lz4
    ArithmeticError,
    AssertionError,
    LookupError,
    MemoryError,  # a length field that was overwritten
    TypeError,
    ValueError,
)

REMEDIES = {
    ".bag": "`rosbag reindex` may rescue it",
    ".mcap": "`mcap recover` may rescue it",
    ".db3": "`sqlite3 FILE .recover` may rescue it",
}


def damaged(path: Path, err: Exception, *, progress: str = "") -> RecordingError:
    """The error to raise for `err`; `progress` says how far the file was read."""
    where = f"{path}: {progress}: " if progress else f"{path}: "
    if isinstance(err, OSError) and err.errno is not None:
        return RecordingError(f"{where}cannot be read: {err.strerror}")
    found = " ".join(str(err).split()) or "unexpected end or value"
    suffix = path.with_suffix("").suffix if path.suffix == ".zstd" else path.suffix
    remedy = REMEDIES.get(suffix, "record or copy it again")
    return RecordingError(f"{where}the file is damaged or was not closed ({type(err).__name__}: {found}); {remedy}")


@contextmanager
def opening(path: Path) -> Iterator[None]:
    """Turn what a library raises while it opens `path` into a `RecordingError`.

    Raises:
        RecordingError: instead of any of `LIBRARY_ERRORS`.
    """
    try:
        yield
    except LidcamError:
        raise
    except LIBRARY_ERRORS as err:
        raise damaged(path, err) from err
