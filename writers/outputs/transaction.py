"""The outputs of one run: all of them appear, or none."""

import os
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import NamedTuple, Self

from pipeline.core.ending import undone_at_once
from pipeline.core.errors import OutputError
from writers.outputs.errors import output_errors
from writers.outputs.exchange import Exchange, exchange, has_journal, identity, sync, sync_folder
from writers.outputs.recovery import recover
from writers.outputs.signals import held_signals
from writers.outputs.target import resolved_output
from writers.outputs.work_folder import WorkFolder, work_folder_path

__all__ = ["OutputFile", "OutputTransaction"]


class OutputFile(NamedTuple):
    """One output while it is written.

    Attributes:
        path: Its name, for messages.
        part: Where to write it. Nothing stands there yet; the folder is this run's own.
    """

    path: Path
    part: Path


class _Member(NamedTuple):
    path: Path
    target: Path
    old: str | None
    """Identity of what stood there when the run began."""


class OutputTransaction:
    """A context manager: the outputs get their names when the block ends without error, else nothing remains.

    Until then each is written in a hidden folder beside it, and old outputs stand. A second run with one of the
    outputs is refused meanwhile. What a killed run has left is completed if all its outputs were whole, else removed.

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
        self._files: dict[Path, OutputFile] = {}
        self._members: list[_Member] = []
        self._work: dict[Path, WorkFolder] = {}
        self._is_recovered = False
        self._undoing = ExitStack()
        self._committing = Lock()

    def __enter__(self) -> Self:
        """Lock the outputs.

        Raises:
            OutputError: one cannot be written, must not be replaced, or is being written by another run.
        """
        try:
            with held_signals():
                self._undoing.enter_context(undone_at_once(self._undo))
                self._open()
        except BaseException:  # also a signal that was held
            with held_signals():
                self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the outputs their names, or discard them.

        Raises:
            OutputError: the system refuses, or an old output was changed meanwhile and must not be replaced.
        """
        try:
            if kind is None and self._members:
                self._sync()
                with held_signals(), self._committing:
                    self._commit()
        finally:
            with held_signals():
                self._close()

    def __getitem__(self, path: Path) -> OutputFile:
        """Where one of the outputs is written."""
        return self._files[path]

    def get(self, path: Path) -> OutputFile | None:
        """Where an output is written; None if it is none of these."""
        return self._files.get(path)

    def _open(self) -> None:
        targets: dict[Path, Path] = {}
        for path in self._paths:
            target = resolved_output(path, is_folder=path in self._folders)
            if target in targets:
                raise OutputError(f"{path}: is the same file as {targets[target]}; choose another name")
            targets[target] = path
        # In one order, so that one of two runs gets all; the shortest first, as errors name what the user named.
        for target in sorted(targets, key=lambda target: (len(target.name), target)):
            with output_errors(targets[target]):
                self._work[target] = WorkFolder(target, targets[target])
        for target, path in targets.items():
            with output_errors(path):
                recover(self._work[target], self._work)
        self._is_recovered = True
        for target, path in targets.items():
            if os.path.lexists(target):
                self._check_old(path)
            with output_errors(path):
                self._members.append(_Member(path, target, identity(target)))
                self._work[target].begin(tuple(targets))
            self._files[path] = OutputFile(path, self._work[target].part)

    def _sync(self) -> None:
        """Wait until the new outputs are on the disk, each with the permissions of what it replaces."""
        for member in self._members:
            with output_errors(member.path):
                part = self._work[member.target].part
                if member.target.exists():
                    part.chmod(member.target.stat().st_mode & 0o777)
                sync(self._work[member.target].path)
                sync_folder(member.target.parent)

    def _commit(self) -> None:
        exchanges = []
        for member in self._members:
            with output_errors(member.path):
                old, new = identity(member.target), identity(self._work[member.target].part)
            if old not in (None, member.old):  # changed while the run went on
                self._check_old(member.path)
            exchanges.append(Exchange(member.target, old, new))
        with output_errors(self._members[0].path):
            exchange(work_folder_path(self._members[0].target), exchanges)

    def _undo(self) -> None:
        """Discard the outputs, called from any thread. Once they get their names, the next run sees to it."""
        if self._committing.acquire(blocking=False):
            self._close()

    def _close(self) -> None:
        is_stuck = bool(self._members) and has_journal(work_folder_path(self._members[0].target))
        while self._work:
            _, folder = self._work.popitem()
            folder.close(is_done=(self._is_recovered or folder.is_new) and not is_stuck)
        self._undoing.close()
