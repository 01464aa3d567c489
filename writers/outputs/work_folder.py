"""The hidden folder beside an output in which a run writes it: `.NAME.lidcam-RANDOM`.

    lock    held while the run goes on (flock: gone with the process)
    NAME    the output, until it is whole

Each run makes a folder of its own, so nothing that lies there before is read. A folder whose lock is free was left by
a run that was killed.
"""

import fcntl
import glob
import logging
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from pipeline.core.errors import OutputError

__all__ = ["WorkFolder", "folder_prefix"]

LOCK = "lock"

logger = logging.getLogger(__name__)


def folder_prefix(target: Path) -> str:
    """Prefix of the names of an output's work folders; `target` without links."""
    return f".{target.name}.lidcam-"


class WorkFolder:
    """The locked work folder of one output.

    Attributes:
        path: The folder.
        part: File or folder in which the output is written. It does not exist yet.
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
        prefix = folder_prefix(target)
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
        self.part = self.path / target.name
        self._lock: int | None = None
        try:
            self._lock = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            with suppress(OSError):  # a file system without locks
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for other in target.parent.glob(f"{glob.escape(prefix)}*"):
                if other != self.path:
                    _take_away(other, shown)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove the folder, and release the lock. Files that the system refuses to remove stay."""
        shutil.rmtree(self.path, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _take_away(folder: Path, shown: Path) -> None:
    """Remove a folder that a killed run has left. What has no lock, or none that can be taken, stays and is named.

    Raises:
        OutputError: its run goes on.
    """
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder)
            logger.info("%s: removed, a run that was killed had left it", folder)
        finally:
            os.close(lock)
    except BlockingIOError:
        raise OutputError(f"{shown}: is being written by another run, in {folder}") from None
    except FileNotFoundError:
        with suppress(OSError):
            folder.rmdir()  # killed before it had a lock
    except OSError as err:
        logger.warning("%s: left as it is: %s", folder, err.strerror)
