"""The hidden folder beside an output in which a run writes it: `.NAME.lidcam-RANDOM`.

    lock    held while the run goes on (flock: gone with the process); says which run it is
    NAME    the output, until it is whole

Each run makes a folder of its own, so nothing that lies there before is believed. Folders that killed runs have left
are known by a lock that is free.
"""

import fcntl
import json
import logging
import os
import shutil
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from pipeline.core.errors import OutputError

__all__ = ["WorkFolder", "folder_prefix"]

LOCK = "lock"
MAX_NAME_BYTES = 200
"""Of the output's name in that of its folder: file systems take 255."""

MAX_NOTE_BYTES = 1 << 12

logger = logging.getLogger(__name__)


def folder_prefix(target: Path) -> str:
    """Prefix of the names of an output's work folders; `target` without links."""
    name = target.name
    if len(os.fsencode(name)) > MAX_NAME_BYTES:
        digest = sha256(os.fsencode(name)).hexdigest()[:16]
        while len(os.fsencode(name)) > MAX_NAME_BYTES - 17:
            name = name[:-1]
        name = f"{name}-{digest}"
    return f".{name}.lidcam-"


class WorkFolder:
    """The locked work folder of one output.

    Attributes:
        path: The folder.
        part: Where the output is written. Nothing stands there yet.
    """

    def __init__(self, target: Path, shown: Path) -> None:
        """Make the folder, lock it, and remove what killed runs have left of this output.

        Args:
            target: The output, without links.
            shown: How the user calls it.

        Raises:
            OutputError: another run writes the output.
            OSError: the folder cannot be made.
        """
        self.path = Path(tempfile.mkdtemp(prefix=folder_prefix(target), dir=target.parent))
        self.part = self.path / target.name
        self._lock: int | None = None
        try:
            self._lock = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            os.write(self._lock, json.dumps({"process": os.getpid(), "host": socket.gethostname()}).encode())
            with suppress(OSError):  # a file system without locks
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for other in target.parent.glob(f"{_escaped(folder_prefix(target))}*"):
                if other != self.path:
                    _take_away(other, shown)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove the folder, and release the lock. What the system refuses to remove stays."""
        shutil.rmtree(self.path, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _escaped(name: str) -> str:
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)


def _take_away(folder: Path, shown: Path) -> None:
    """Remove a folder that a killed run has left; what may be something else stays, and is named.

    Raises:
        OutputError: its run goes on.
    """
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        with suppress(OSError):
            folder.rmdir()  # killed before it had a lock
        return
    except OSError as err:
        logger.warning("%s: left as it is: %s", folder, err.strerror)
        return
    try:
        if not _is_left(folder, lock):
            logger.warning("%s: left as it is: expected plain files of this user alone", folder)
            return
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
        logger.info("%s: removed, a run that was killed had left it", folder)
    except BlockingIOError:
        raise OutputError(f"{shown}: is being written by another run{_who(lock)}") from None
    except OSError:
        raise OutputError(
            f"{shown}: another run writes it or was killed ({folder}), and this file system has no locks that tell; "
            "remove that folder if no run is active"
        ) from None
    finally:
        os.close(lock)


def _is_left(folder: Path, lock: int) -> bool:
    """Whether a folder holds plain files of this user alone, and the descriptor is that of its lock."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or not stat.S_ISREG(os.fstat(lock).st_mode):
        return False
    inside = list(_all_in(folder))
    return all(
        one.st_uid == os.geteuid()
        and one.st_dev == found.st_dev
        and (stat.S_ISREG(one.st_mode) or stat.S_ISDIR(one.st_mode))
        for one in (found, *inside)
    )


def _all_in(folder: Path) -> Iterator[os.stat_result]:
    for entry in os.scandir(folder):
        yield entry.stat(follow_symlinks=False)
        if entry.is_dir(follow_symlinks=False):
            yield from _all_in(Path(entry.path))


def _who(lock: int) -> str:
    """The run that holds a lock, in brackets; nothing if it has not said so yet."""
    with suppress(ValueError, TypeError, KeyError, RecursionError, OSError):
        note = json.loads(os.pread(lock, MAX_NOTE_BYTES, 0))
        host = "" if note["host"] == socket.gethostname() else f" on {note['host']}"
        return f" (process {int(note['process'])}{host})"
    return ""
