"""The outputs of one run: they get their names when all of them are whole and on the disk.

What the system refuses becomes an OutputError.
"""

import os
import stat
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from lidcam.pipeline.core.errors import OutputError
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.work_folder import WorkFolder

FOUND = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link; name what it points to, or choose another name",
}


@dataclass(frozen=True, slots=True)
class OutputFile:
    """One output while it is written."""

    path: Path  # Its name, for messages
    part: Path  # File or folder to write. It does not exist yet; its folder is this run's own

    def write_text(self, text: str) -> None:
        """Write a text as the whole output."""
        self.write_bytes(text.encode())

    def write_bytes(self, content: bytes) -> None:
        """Write bytes as the whole output."""
        with output_errors(self.path), self.part.open("xb") as file:
            file.write(content)


class OutputTransaction:
    """A context manager: the outputs get their names when the block ends without error, else nothing remains.

    Until then each is written in a hidden folder beside it, and old outputs stand; folders that are missing are made. A
    second run with one of the outputs is refused meanwhile. Names are given one after another: a run that is killed
    between two of them leaves a new output beside an old one.

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

    def __enter__(self) -> Self:
        """Make the folders and lock them; OutputError: one must not be replaced, or another run writes it."""
        try:
            self._open()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the outputs their names, or discard them; OutputError: what stands there now must not be replaced."""
        try:
            if kind is None and self._work:
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

    def _commit(self) -> None:
        for path, target in self._targets.items():
            with output_errors(path):
                if os.path.lexists(target):
                    self._check_old(path)
                self._work[path].sync()
        for path in reversed(self._paths):
            with output_errors(path):
                self._work[path].give_name()

    def _close(self) -> None:
        for folder in reversed(self._work.values()):  # the first may have made the folder of the others
            folder.close()
        self._work.clear()


def _resolved(path: Path, *, is_folder: bool) -> Path:
    """The output, in a folder without links.

    Raises:
        OutputError: it is a URL, or something other than a file (a folder) stands there. A link is neither: it may come
            with a data set, and lead anywhere.
    """
    expected = f"{path}: expected the name of a {'folder' if is_folder else 'file'} to write"
    with output_errors(path):
        try:
            target = path.parent.resolve() / path.name
            found = stat.S_IFMT(target.lstat().st_mode)
        except FileNotFoundError:
            if path.parts[0].endswith(":") and not Path(path.parts[0]).exists():  # as pathlib writes a URL
                raise OutputError(f"{expected} on this machine, found a URL") from None
        except (ValueError, RuntimeError) as err:  # a null character; links in a circle
            raise OutputError(f"{expected}: {err}") from err
        else:
            if found != (stat.S_IFDIR if is_folder else stat.S_IFREG):
                raise OutputError(f"{expected}, found {FOUND.get(found, 'a device or a pipe')}")
    return target
