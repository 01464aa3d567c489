"""What an output must never replace: an input of the run, and what lidcam did not write itself."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.core.errors import OutputError
from readers.location import Location
from writers.outputs.errors import output_errors
from writers.outputs.work_folder import folder_prefix

if TYPE_CHECKING:
    from lidcam.outputs.made import Made

__all__ = ["check_no_input", "check_replaced"]

SQLITE_SUFFIXES = ("-journal", "-wal", "-shm")
"""Of the files in which SQLite keeps changes of a database: it applies them when it opens the database."""

TEXT_SUFFIXES = (".json", ".yaml")
"""Of what is written beside an output, or to be edited."""


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


def check_replaced(made: "Made", *, overwrite: bool) -> Callable[[Path], None]:
    """A check of old outputs, for `OutputTransaction`: only what an earlier run of the same kind wrote is replaced.

    Args:
        made: What the run makes; texts beside it may be replaced while they are unchanged.
        overwrite: Replace other files, too.
    """

    def check(path: Path) -> None:
        with output_errors(path):
            if overwrite:
                return
            from lidcam.outputs.made import made_by_lidcam  # reads all kinds of files; mostly nothing stands there

            found = made_by_lidcam(path)
            if found not in (made, "text"):
                found_text = _FOUND["text" if path.suffix in TEXT_SUFFIXES else made]
                raise OutputError(f"{path}: {found_text}; choose another name, or replace it with --overwrite")
            if not os.access(path, os.W_OK):
                raise OutputError(f"{path}: is write-protected; choose another name, or replace it with --overwrite")

    return check


_FOUND: dict["Made", str] = {
    "result": "exists and is no result of an earlier run (a recording? the output comes last)",
    "repaired": "exists and was not written by an earlier --repair",
    "simulated": "exists and is no simulated recording",
    "merged": "exists and was not written by an earlier --merged",
    "text": "exists and is not as this version writes it (edited, or written by an earlier version)",
}


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (ValueError, RuntimeError):  # no path at all: whoever opens it will say so
        return path
