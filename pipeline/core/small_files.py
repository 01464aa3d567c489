"""Files that are read as a whole: settings, rigs, labels, names, requirements."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EFBIG, EINVAL
from io import BufferedReader
from pathlib import Path
from stat import S_ISREG

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.system import NO_WAIT

LFS_POINTER, LFS_REMEDY = b"version https://git-lfs", "a Git LFS pointer in its place; fetch it with `git lfs pull`"
"""First bytes of what Git leaves in the place of a large file that was not fetched, and what to do."""


@contextmanager
def open_regular(path: Path, flags: int = 0) -> Iterator[BufferedReader]:
    """Open a regular file to read. Neither waits for a FIFO nor reads from a device that has no end.

    `flags` are further ones of open(2), for instance `NO_FOLLOW`. Raises OSError if it cannot be opened, or is no
    regular file.
    """
    with open(path, "rb", opener=lambda name, given: os.open(name, given | NO_WAIT | flags)) as stream:
        if not S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise OSError(EINVAL, "expected a regular file, found a FIFO or a device", str(path))
        yield stream


def read_small_file(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file of at most `max_bytes`; raises OSError if it is none, or cannot be opened."""
    with open_regular(path) as stream:
        data = stream.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise OSError(EFBIG, f"expected at most {max_bytes / 2**20:g} MiB, found a larger file", str(path))
    return data


def read_small_text(path: Path, max_bytes: int, expected: str, error: type[LidcamError]) -> str:
    """The text of a regular file of at most `max_bytes`; `expected` names its kind in messages: `a rig file`.

    Raises:
        LidcamError: (`error`) it cannot be read, is no regular file, is larger or no UTF-8; one line that names it.
    """
    try:
        data = read_small_file(path, max_bytes)
        if data.startswith(LFS_POINTER):
            raise error(f"{path}: expected {expected}, found {LFS_REMEDY}")
        return data.decode("utf-8-sig")  # some editors begin a file with a mark
    except FileNotFoundError as err:
        raise error(f"{path}: expected {expected}, found no such file") from err
    except UnicodeDecodeError as err:
        raise error(f"{path}: expected {expected} as UTF-8 text, found other bytes at {err.start}") from err
    except OSError as err:
        raise error(f"{path}: cannot be read as {expected}: {err.strerror or err}") from err
