"""Temporary folders for what must be unpacked or completed before it can be read.

A killed run cannot remove its own; the next one does. Whose run has ended is told by a lock, which goes with the
process, not by a number, which another process may have got since.
"""

import fcntl
import logging
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from pipeline.core.ending import undone_at_once

__all__ = ["PREFIX", "remove_abandoned", "temporary_folder"]

PREFIX = "lidcam-unpacked-"
_OURS = re.compile(rf"{PREFIX}[a-z0-9_]{{8}}")
"""As `tempfile` names it."""

_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

logger = logging.getLogger(__name__)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder of this process in the system's temporary folder; removed at the end of the block.

    Raises:
        OSError: it cannot be made.
    """
    folder, lock = _locked_folder()
    try:
        with undone_at_once(partial(shutil.rmtree, folder, ignore_errors=True)):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def remove_abandoned() -> None:
    """Remove the temporary folders of this user's killed runs; no link is followed, and what cannot go stays."""
    with suppress(OSError):
        for folder in Path(tempfile.gettempdir()).iterdir():
            if _OURS.fullmatch(folder.name):
                with suppress(OSError):
                    _remove_if_abandoned(folder)


def _remove_if_abandoned(folder: Path) -> None:
    lock = os.open(folder, _FLAGS)
    try:
        status = os.fstat(lock)
        if status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) == 0o700:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused while its run goes on
            shutil.rmtree(folder)
            logger.info("%s: removed, a run that was killed had left it", folder)
    finally:
        os.close(lock)


def _locked_folder() -> tuple[Path, int]:
    """A new folder, and the descriptor that holds its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        with suppress(FileNotFoundError):  # another run took it for abandoned before it was locked
            lock = os.open(folder, _FLAGS)
            if _is_locked(folder, lock):
                return folder, lock
            os.close(lock)


def _is_locked(folder: Path, lock: int) -> bool:
    """Whether a folder is there and locked now, or this file system has no locks, so that nobody removes it."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False  # another run is about to remove it
    except OSError:
        return True
    try:
        return os.path.samestat(os.lstat(folder), os.fstat(lock))
    except FileNotFoundError:
        return False
