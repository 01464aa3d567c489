"""The hidden folder beside an output in which a run writes it: `.NAME.lidcam-RANDOM`.

    NAME         the output, until it is whole
    NAME.lock    held while the run goes on (flock: gone with the process)
    NAME.old     a folder that the output replaces, for a moment

Each run makes a folder of its own, so nothing that lies there before is read. Folders are held by descriptor, and what
has to be renamed or removed is named relative to them: a link is never followed.
"""

import errno
import fcntl
import logging
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import OutputError

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
LOCK = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC

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

        Args:
            target: The output, without links.
            shown: How the user calls it.

        Raises:
            OutputError: another run writes the output.
            OSError: the folder cannot be made.
        """
        self.path = target.with_name(f"{folder_prefix(target)}{secrets.token_hex(4)}")
        self.part = self.path / target.name
        self._target, self._lock_name, self._old_name = target, f"{target.name}.lock", f"{target.name}.old"
        self._held = ExitStack()
        self._missing = [folder for folder in target.parents if not folder.exists()]
        self._parent = -1
        try:
            self._held.enter_context(undone_at_once(self.close))
            if self._missing:
                target.parent.mkdir(parents=True, exist_ok=True)
            self._parent = self._held.enter_context(_opened(target.parent, FOLDER))
            os.mkdir(self.path.name, 0o700, dir_fd=self._parent)
            self._folder = self._held.enter_context(_opened(self.path.name, FOLDER, self._parent))
            lock = self._held.enter_context(_opened(self._lock_name, LOCK | os.O_CREAT | os.O_EXCL, self._folder))
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._remove_leftovers(shown)
        except BaseException:
            self.close()
            raise

    def sync(self) -> None:
        """Wait until the output is on the disk, with the permissions of this user's file that it replaces.

        Raises:
            OSError: it cannot be written, or the folder is no longer where it was made.
        """
        own = os.fstat(self._folder)
        if not os.path.samestat(os.lstat(self.path), own):
            raise OSError(errno.ESTALE, "its folder was replaced meanwhile")
        if os.path.lexists(self._target) and self.part.exists():
            old = os.lstat(self._target)
            if old.st_uid == own.st_uid and not stat.S_ISLNK(old.st_mode):
                self.part.chmod(stat.S_IMODE(old.st_mode) & 0o777)
        _sync(self.path)

    def give_name(self) -> None:
        """Put the output, if it was written, in the place of what stands there.

        Raises:
            OSError: the system refuses; what stood there stays, or comes back at the end.
        """
        name = self.part.name
        if os.path.lexists(self.part):
            if self._target.is_dir():  # no system replaces a folder that holds something
                _move(self._parent, name, self._folder, self._old_name)
            _move(self._folder, name, self._parent, name)
            _sync_one(self._parent)

    def close(self) -> None:
        """Remove the folder and those made around it that hold nothing, and release the lock.

        Files that the system refuses to remove stay.
        """
        with suppress(OSError):
            if (self.path / self._old_name).exists() and not os.path.lexists(self._target):
                _move(self._folder, self._old_name, self._parent, self.part.name)  # nothing has taken its place
            shutil.rmtree(self.path.name, ignore_errors=True, dir_fd=self._parent)
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
        for name in sorted(entry.name for entry in os.scandir(self._parent)):
            if name.startswith(folder_prefix(self._target)) and name != self.path.name:
                try:
                    with suppress(FileNotFoundError):  # its run has just ended
                        self._remove_leftover(name)
                except BlockingIOError:
                    where = self.path.with_name(name)
                    raise OutputError(f"{shown}: is being written by another run, in {where}") from None
                except OSError as err:
                    left.append(f"{self.path.with_name(name)} ({err.strerror})")
        if left:
            more = f" and {len(left) - 1} more of such names" if len(left) > 1 else ""
            logger.warning("%s%s: left as it is; remove what you do not need", left[0], more)

    def _remove_leftover(self, name: str) -> None:
        """Remove a folder that a killed run has made: plain files, or a folder of plain files, and a lock that is free.

        Raises:
            BlockingIOError: its run goes on.
            OSError: something else is in it, or not of this run's user and file system; or it cannot be removed.
        """
        own, output = os.fstat(self._folder), self.part.name
        with ExitStack() as held:
            folder = held.enter_context(_opened(name, FOLDER, self._parent))
            for path, folders, files, descriptor in os.fwalk(".", dir_fd=folder):
                for entry in (".", *folders, *files):
                    status = os.stat(entry, dir_fd=descriptor, follow_symlinks=False)
                    is_folder = stat.S_ISDIR(status.st_mode) and (entry == "." or (path, entry) == (".", output))
                    is_own = (status.st_uid, status.st_dev) == (own.st_uid, own.st_dev)
                    if not (is_own and (is_folder or stat.S_ISREG(status.st_mode))):
                        raise OSError(errno.EINVAL, "no run of yours has left all of it")
            try:
                lock = held.enter_context(_opened(self._lock_name, LOCK, folder))
            except FileNotFoundError:  # killed before it had one: nothing else is in it
                os.rmdir(name, dir_fd=self._parent)
            else:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(name, dir_fd=self._parent)
            logger.info("%s: removed, a run that was killed had left it", self.path.with_name(name))


@contextmanager
def _opened(name: str | Path, flags: int, folder: int | None = None) -> Iterator[int]:
    descriptor = os.open(name, flags, 0o600, dir_fd=folder)
    try:
        yield descriptor
    finally:
        with suppress(OSError):  # nothing was written through it
            os.close(descriptor)


def _move(folder: int, name: str, to_folder: int, to_name: str) -> None:
    os.rename(name, to_name, src_dir_fd=folder, dst_dir_fd=to_folder)


def _sync(path: Path) -> None:
    """Wait until a file, or a folder with all that is in it, is on the disk."""
    if path.is_dir() and not path.is_symlink():
        for entry in path.iterdir():
            _sync(entry)
    with _opened(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC) as descriptor:
        _sync_one(descriptor)


def _sync_one(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in CANNOT_SYNC:
            raise
