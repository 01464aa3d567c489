"""The hidden folder beside an output in which it is written: `.NAME.lidcam`, with the lock of the output.

    lock      held while a run writes the output (flock: gone with the process); says which run
    new/      what is being written, under the name of the output
    old/      the old output, while the new one takes its name
    journal   in that of the run's first output: all outputs are whole and are being renamed (see `exchange`)

A run that is killed leaves it; the next run with the same output takes it over. The name follows from that of the
output, so that two runs meet; it is a folder of one's own, so that nobody else can put links into it.
"""

import contextlib
import errno
import fcntl
import json
import os
import shutil
import socket
import stat
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from pipeline.core.errors import OutputError

__all__ = ["BusyError", "WorkFolder", "Writing", "is_work_folder", "remove", "work_folder_path"]

_SUFFIX = ".lidcam"
_MAX_NAME_BYTES = 200
"""Of the output's name in that of its folder: file systems take 255."""

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
_ATTEMPTS = 100
_NOTE_ATTEMPTS = 100
_MAX_NOTE_BYTES = 1 << 16


def work_folder_path(target: Path) -> Path:
    """The work folder of an output; `target` without links."""
    name = target.name
    if len(os.fsencode(name)) > _MAX_NAME_BYTES:
        digest = sha256(os.fsencode(name)).hexdigest()[:16]
        while len(os.fsencode(name)) > _MAX_NAME_BYTES - 17:
            name = name[:-1]
        name = f"{name}-{digest}"
    return target.with_name(f".{name}{_SUFFIX}")


def is_work_folder(path: Path) -> bool:
    """Whether a path is named like a work folder."""
    return path.name.startswith(".") and path.name.endswith(_SUFFIX) and len(path.name) > len(_SUFFIX) + 1


def remove(path: Path) -> None:
    """Remove a file, a link or a folder; no link is followed.

    Raises:
        OSError: it cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


class BusyError(OutputError):
    """Another run writes the output."""


class Writing(NamedTuple):
    """A run that writes outputs.

    Attributes:
        process: Its number.
        host: Where it runs.
        outputs: All its outputs, without links.
    """

    process: int
    host: str
    outputs: tuple[Path, ...]


class WorkFolder:
    """The locked work folder of one output.

    Attributes:
        target: The output, without links.
        path: The folder.
        left_by: The run that left the folder; None if none did.
        is_new: Whether the folder was not there before.
    """

    def __init__(self, target: Path, shown: Path) -> None:
        """Make the folder if it is missing, and lock it.

        Args:
            target: The output, without links.
            shown: How the user calls it.

        Raises:
            OutputError: another run holds the lock, or something else has the folder's name.
            OSError: it cannot be made.
        """
        self.target, self.path, self._shown = target, work_folder_path(target), shown
        self.is_new = False
        self._lock = self._locked()
        self.left_by = _read_note(self._lock, self.path)

    @property
    def part(self) -> Path:
        """Where the output is written."""
        return self.path / "new" / self.target.name

    @property
    def kept(self) -> Path:
        """Where the old output is kept while the new one takes its name."""
        return self.path / "old" / self.target.name

    def begin(self, outputs: Sequence[Path]) -> None:
        """Empty the folder, and write into the lock who writes the output now.

        Args:
            outputs: All outputs of the run, without links.

        Raises:
            OSError: it cannot be written.
        """
        self.empty()
        for folder in (self.part.parent, self.kept.parent):
            folder.mkdir(mode=0o700)
        # Relative: the folders may be moved, or be mounted elsewhere.
        names = [os.path.relpath(output, self.path) for output in outputs]
        note = {"process": os.getpid(), "host": socket.gethostname(), "outputs": names}
        os.ftruncate(self._lock, 0)
        os.pwrite(self._lock, json.dumps(note).encode(), 0)

    def empty(self) -> None:
        """Remove what was being written.

        Raises:
            OSError: it cannot be removed.
        """
        for name in ("journal", "undo", "journal.new", "new", "old"):
            remove(self.path / name)

    def close(self, *, is_done: bool) -> None:
        """Release the lock; the folder goes if its work is done. What the system refuses to remove stays."""
        if is_done:
            with contextlib.suppress(OSError):
                self.empty()
                (self.path / "lock").unlink()  # while it is held: who waits for it sees that it is gone
                self.path.rmdir()
        _close(self._lock)

    def _locked(self) -> int:
        for _ in range(_ATTEMPTS):
            try:
                self.path.mkdir(mode=0o700)
                self.is_new = True
            except FileExistsError:
                self.is_new = False
            with contextlib.suppress(FileNotFoundError):  # removed by the run that has just ended
                if (descriptor := self._try_lock()) is not None:
                    return descriptor
            time.sleep(0.002)
        raise BusyError(f"{self._shown}: is being written by another run")

    def _try_lock(self) -> int | None:
        """The lock, if it is held now and is still the one that others see."""
        if not self.is_new:
            self._check_owner()
        try:
            descriptor = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError:
            if self.is_new:
                with contextlib.suppress(OSError):
                    self.path.rmdir()
            raise
        try:
            self._flock(descriptor)
            if os.path.samestat((self.path / "lock").lstat(), os.fstat(descriptor)):
                return descriptor
        except BaseException:
            _close(descriptor)
            raise
        _close(descriptor)
        return None

    def _check_owner(self) -> None:
        """Whether the folder that is there can be of a run of this user."""
        found = os.lstat(self.path)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
            raise OutputError(
                f"{self._shown}: {self.path} is in the way: expected a folder of an earlier run of this user"
            )

    def _flock(self, descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusyError(f"{self._shown}: is being written by another run{_who(descriptor, self.path)}") from None
        except OSError as err:
            if err.errno not in _NO_LOCKS:
                raise
            if not self.is_new:
                raise OutputError(
                    f"{self._shown}: another run writes it or was killed ({self.path}), and this file system has no "
                    "locks that tell; remove that folder if no run is active"
                ) from None


def _close(descriptor: int) -> None:
    """Nothing was written that could be lost by an error."""
    with contextlib.suppress(OSError):
        os.close(descriptor)


def _who(descriptor: int, folder: Path) -> str:
    """The run that holds a lock; it writes its number a moment after it has locked."""
    for _ in range(_NOTE_ATTEMPTS):
        if found := _read_note(descriptor, folder):
            return f" (process {found.process}{'' if found.host == socket.gethostname() else f' on {found.host}'})"
        time.sleep(0.01)
    return ""


def _read_note(descriptor: int, folder: Path) -> Writing | None:
    with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
        note = json.loads(os.pread(descriptor, _MAX_NOTE_BYTES, 0))
        outputs = tuple(Path(os.path.normpath(folder / name)) for name in note["outputs"])
        return Writing(int(note["process"]), str(note["host"]), outputs)
    return None
