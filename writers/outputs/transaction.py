"""The outputs of one run: they get their names when all of them are whole and on the disk."""

import errno
import os
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from pipeline.core.ending import undone_at_once
from pipeline.core.errors import OutputError
from writers.outputs.errors import output_errors
from writers.outputs.work_folder import WorkFolder

__all__ = ["OutputFile", "OutputTransaction"]

CANNOT_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}
"""Answers of file systems that have no fsync of a folder."""


@dataclass(frozen=True, slots=True)
class OutputFile:
    """One output while it is written.

    Attributes:
        path: Its name, for messages.
        part: File or folder to write. It does not exist yet; its folder is this run's own.
    """

    path: Path
    part: Path


class OutputTransaction:
    """A context manager: the outputs get their names when the block ends without error, else nothing remains.

    Until then each is written in a hidden folder beside it, and old outputs stand. A second run with one of the
    outputs is refused meanwhile. Names are given one after another: a run that is killed between two of them leaves
    a new output beside an old one.

    Args:
        paths: All outputs of the run; the first gets its name last, so that where it is, the others are.
        folders: Those of them that are folders.
        check_old: Called with an existing output that is about to be replaced; raises OutputError if it must not be.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        folders: Collection[Path] = (),
        check_old: Callable[[Path], None] = lambda _: None,
    ) -> None:
        self._paths, self._folders, self._check_old = tuple(paths), folders, check_old
        self._targets: dict[Path, Path] = {}
        self._work: dict[Path, WorkFolder] = {}
        self._undoing = ExitStack()
        self._is_committing = False

    def __enter__(self) -> Self:
        """Make the folders and lock them.

        Raises:
            OutputError: an output cannot be written, must not be replaced, or is being written by another run.
        """
        try:
            self._undoing.enter_context(undone_at_once(self._undo))
            self._open()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the outputs their names, or discard them.

        Raises:
            OutputError: the system refuses, or what stands there now must not be replaced.
        """
        try:
            if kind is None and self._work:
                self._sync()
                self._is_committing = True
                self._commit()
        finally:
            self._close()

    def __getitem__(self, path: Path) -> OutputFile:
        """The file in which one of the outputs is written."""
        return OutputFile(path, self._work[path].part)

    def get(self, path: Path) -> OutputFile | None:
        """The file in which an output is written; None if it is not an output of this run."""
        return self[path] if path in self._work else None

    def _open(self) -> None:
        for path in self._paths:
            target = _resolved(path, is_folder=path in self._folders)
            for other, known in self._targets.items():
                if known == target:
                    raise OutputError(f"{path}: is the same file as {other}; choose another name")
            self._targets[path] = target
        for path, target in self._targets.items():
            with output_errors(path):
                self._work[path] = WorkFolder(target, path)
        for path, target in self._targets.items():
            if os.path.lexists(target):
                self._check_old(path)

    def _sync(self) -> None:
        """Wait until the new outputs are on the disk, each with the permissions of what it replaces."""
        for path, target in self._targets.items():
            with output_errors(path):
                part = self._work[path].part
                if target.exists():
                    self._check_old(path)
                    if part.exists():
                        part.chmod(target.stat().st_mode & 0o777)
                _sync(part.parent)

    def _commit(self) -> None:
        for path in reversed(self._paths):
            target, work = self._targets[path], self._work[path]
            if not os.path.lexists(work.part):
                continue  # nothing was written
            with output_errors(path):
                if target.is_dir():  # no system replaces a folder that holds something
                    target.rename(work.path / "old")
                work.part.replace(target)
                _sync_one(target.parent)

    def _undo(self) -> None:
        """Discard the outputs, unless they are getting their names: then an old folder may be in a work folder."""
        if not self._is_committing:
            self._close()

    def _close(self) -> None:
        while self._work:
            _, folder = self._work.popitem()
            folder.close()
        self._undoing.close()


def _resolved(path: Path, *, is_folder: bool) -> Path:
    """The output without links: a link stays, and the file that it points to is replaced.

    Raises:
        OutputError: its folder is missing, or something other than a file (a folder) stands there.
    """
    expected = f"{path}: expected the name of a {'folder' if is_folder else 'file'} to write"
    with output_errors(path):
        try:
            target = path.resolve()
        except (ValueError, RuntimeError) as err:  # a null character; links in a circle
            raise OutputError(f"{expected}: {err}") from err
        if not target.parent.is_dir():
            raise OutputError(f"{path}: the folder {target.parent} does not exist; create it first")
        if target.exists() and not (target.is_dir() if is_folder else target.is_file()):
            found = "a folder" if target.is_dir() else "a file" if target.is_file() else "a device or a pipe"
            raise OutputError(f"{expected}, found {found}")
    return target


def _sync(path: Path) -> None:
    """Wait until a file, or a folder with all that is in it, is on the disk."""
    if path.is_dir() and not path.is_symlink():
        for entry in path.iterdir():
            _sync(entry)
    _sync_one(path)


def _sync_one(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as err:
        if err.errno not in CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)
