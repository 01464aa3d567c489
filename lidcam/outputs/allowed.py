"""What an output must never replace: an input of the run, and what lidcam did not write itself."""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lidcam.outputs.made import is_marked_mcap, is_simulated, is_unchanged
from pipeline.core.errors import OutputError
from readers.location import Location
from writers.outputs import marks
from writers.outputs.errors import output_errors
from writers.outputs.work_folder import folder_prefix

__all__ = ["MERGED", "REPAIRED", "SIMULATED", "TEXT", "Replaceable", "check_no_input", "check_replaced"]

SQLITE_SUFFIXES = ("-journal", "-wal", "-shm")
"""Of the files in which SQLite keeps changes of a database: it applies them when it opens the database."""


def check_no_input(outputs: Sequence[Path], inputs: Iterable[Location]) -> None:
    """Whether no output is an input: by its name, by a link, inside its folder, or as a part of its database.

    Args:
        outputs: What is to be written.
        inputs: Files and folders that are read.

    Raises:
        OutputError: one is.
    """
    sources = [path for path in inputs if isinstance(path, Path)]
    for output in outputs:
        with output_errors(output):
            target = _resolved(output)
            for source in sources:
                _check_one(output, target, source, _resolved(source))


def _check_one(output: Path, target: Path, source: Path, resolved: Path) -> None:
    stands = target.exists()
    is_same = target == resolved or (stands and source.exists() and target.samefile(source))
    is_metadata = resolved in target.parents and target.name == "metadata.yaml"
    is_around = stands and target in resolved.parents
    is_journal = any(target == resolved.with_name(f"{resolved.name}{suffix}") for suffix in SQLITE_SUFFIXES)
    if is_same or is_metadata or is_around or is_journal:
        raise OutputError(f"{output}: is an input of this run ({source}), or a part of one; choose another name")
    if any(
        folder.parent == target.parent and folder.name.startswith(folder_prefix(target)) for folder in resolved.parents
    ):
        raise OutputError(
            f"{output}: the input {source} is what a killed run has left of this output; move it elsewhere first"
        )


@dataclass(frozen=True, slots=True)
class Replaceable:
    """What a command may replace without --overwrite: what it wrote itself.

    Attributes:
        is_own: Whether the command wrote the file or folder that stands at a path.
        otherwise: What is said of one that it did not write.
    """

    is_own: Callable[[Path], bool]
    otherwise: str


TEXT = Replaceable(
    is_unchanged, "exists and is not as this version writes it (edited, or written by an earlier version)"
)
"""Layouts, JSON, drafts of a rig."""

REPAIRED = Replaceable(lambda path: is_marked_mcap(path, marks.REPAIRED), "exists and was not written by --repair")
MERGED = Replaceable(lambda path: is_marked_mcap(path, marks.MERGED), "exists and was not written by --merged")
SIMULATED = Replaceable(is_simulated, "exists and is no simulated recording")


def check_replaced(replaceable: Callable[[Path], Replaceable], *, overwrite: bool) -> Callable[[Path], None]:
    """A check of old outputs, for `OutputTransaction`.

    Args:
        replaceable: What may be replaced at a path.
        overwrite: Replace other files, too.
    """

    def check(path: Path) -> None:
        with output_errors(path):
            if overwrite:
                return
            allowed = replaceable(path)
            if not allowed.is_own(path):
                raise OutputError(f"{path}: {allowed.otherwise}; choose another name, or replace it with --overwrite")
            if not os.access(path, os.W_OK):
                raise OutputError(f"{path}: is write-protected; choose another name, or replace it with --overwrite")

    return check


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (ValueError, RuntimeError):  # no path at all: whoever opens it will say so
        return path
