"""The hidden folder beside an output in which a run writes it: `.NAME.lidcam-RANDOM`.

    NAME         the output, until it is whole
    NAME.lock    held while the run goes on (flock: gone with the process)
    NAME.old     a folder that the output replaces, for a moment

Each run makes a folder of its own, so nothing that lies there before is read.
"""

import errno
import logging
import os
import secrets
import shutil
import stat
from contextlib import ExitStack, suppress
from pathlib import Path

from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.system import NO_FOLLOW, NOT_INHERITED, check_writable_here, lock_file

CANNOT_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}
"""Answers of file systems that have no fsync of a folder."""

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
        """Make the folder, in folders made where missing, lock it, and remove what killed runs left of this output.

        The target is without links; error messages show another name.

        Raises:
            OutputError: another run writes the output, or lidcam does not write on this system.
        """
        check_writable_here()
        self.path = target.with_name(f"{folder_prefix(target)}{secrets.token_hex(4)}")
        self.part, self._old = self.path / target.name, self.path / f"{target.name}.old"
        self._target, self._held = target, ExitStack()
        self._missing = [folder for folder in target.parents if not folder.exists()]
        try:
            self._held.enter_context(undone_at_once(self.close))
            target.parent.mkdir(parents=True, exist_ok=True)
            self.path.mkdir(0o700)
            lock = self._held.enter_context((self.path / f"{target.name}.lock").open("xb"))
            with suppress(OSError):  # a file system without locks
                lock_file(lock)
            self._remove_leftovers(shown)
        except BaseException:
            self.close()
            raise

    def sync(self) -> None:
        """Wait until the output is on the disk, with the permissions of this user's file that it replaces."""
        if os.path.lexists(self._target) and self.part.exists():
            old = self._target.lstat()
            if old.st_uid == os.geteuid() and not stat.S_ISLNK(old.st_mode):
                self.part.chmod(stat.S_IMODE(old.st_mode) & 0o777)
        for folder, _, files in os.walk(self.path):
            for name in (*files, "."):
                _sync(Path(folder, name))

    def give_name(self) -> None:
        """Put the output, if it was written, in the place of what stands there, which is back at the end if refused."""
        if os.path.lexists(self.part):
            if self._target.is_dir():  # no system replaces a folder that holds something
                self._target.rename(self._old)
            self.part.rename(self._target)
            _sync(self._target.parent)

    def close(self) -> None:
        """Remove the folder and those made around it that hold nothing, and release the lock.

        Files that the system refuses to remove stay.
        """
        with suppress(OSError):
            if self._old.exists() and not os.path.lexists(self._target):
                self._old.rename(self._target)  # nothing has taken its place
        shutil.rmtree(self.path, ignore_errors=True)
        with suppress(OSError):
            for folder in self._missing:
                folder.rmdir()
        self._held.close()

    def _remove_leftovers(self, shown: Path) -> None:
        """Remove what killed runs have left of this output. Anything else of such a name stays, and a warning says so.

        Raises:
            OutputError: a run goes on.
        """
        left = []
        for path in sorted(self._target.parent.iterdir()):
            if path.name.startswith(folder_prefix(self._target)) and path != self.path:
                try:
                    with suppress(FileNotFoundError):  # its run has just ended
                        self._remove_leftover(path)
                except BlockingIOError:
                    raise OutputError(f"{shown}: is being written by another run, in {path}") from None
                except OSError as err:
                    left.append(f"{path} ({err.strerror})")
        if left:
            more = f" and {len(left) - 1} more of such names" if len(left) > 1 else ""
            logger.warning("%s%s: left as it is; remove what you do not need", left[0], more)

    def _remove_leftover(self, path: Path) -> None:
        """Remove a folder that a killed run has made: plain files, or a folder of plain files, and a lock that is free.

        Raises:
            BlockingIOError: its run goes on.
            OSError: something else is in it, or not of this user; or it cannot be removed.
        """
        for folder, folders, files in os.walk(path, followlinks=False):
            for name in (".", *folders, *files):
                status = Path(folder, name).lstat()
                is_output = name == "." or (folder == str(path) and name == self._target.name)
                is_own = stat.S_ISREG(status.st_mode) or (is_output and stat.S_ISDIR(status.st_mode))
                if not is_own or status.st_uid != os.geteuid():
                    raise OSError(errno.EINVAL, "no run of yours has left all of it")
        if path.is_symlink() or not path.is_dir():
            raise OSError(errno.EINVAL, "no run of yours has left it")
        lock = path / f"{self._target.name}.lock"
        if not lock.exists():  # killed before it had one: nothing else is in it
            path.rmdir()
            return
        with lock.open("rb") as held:
            lock_file(held)
            shutil.rmtree(path)
        logger.info("%s: removed, a run that was killed had left it", path)


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | NO_FOLLOW | NOT_INHERITED)
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)
