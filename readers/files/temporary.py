"""Temporary folders for what must be unpacked or completed before it can be read.

A killed run cannot remove its own; a later one does. A lock, which goes with the process, says whether a run has ended;
its number would not, as another process may have got it since.
"""

import fcntl
import logging
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from lidcam.pipeline.core.ending import undone_at_once

PREFIX = "lidcam-unpacked-"
_OURS = re.compile(rf"{PREFIX}[a-z0-9_]{{8}}")
"""As `tempfile` names it."""

MIN_AGE_S = 60.0
"""Younger folders stay: their run may be about to lock them."""

_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

logger = logging.getLogger(__name__)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder of this process in the system's temporary folder; removed at the end of the block.

    Raises:
        OSError: it cannot be made.
    """
    folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    lock = os.open(folder, _FLAGS)
    try:
        with undone_at_once(partial(shutil.rmtree, folder, ignore_errors=True)):
            with suppress(OSError):  # some file systems have no locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
        is_ours = status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) == 0o700
        if is_ours and time.time() - status.st_mtime > MIN_AGE_S:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused while its run goes on
            shutil.rmtree(folder)
            logger.info("%s: removed, a run that was killed had left it", folder)
    finally:
        os.close(lock)
