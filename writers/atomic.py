"""Output files that are complete or absent, never partial."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from pipeline.core.ending import undone_at_once
from pipeline.core.errors import OutputError

__all__ = ["atomic_output", "output_errors"]


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """The path to write to, `<name>.part` beside the target, renamed to the target when the block ends without error.

    If the block raises, the `.part` is removed and an existing target stays as it was. A killed run leaves at most the
    `.part`, which the next run overwrites.

    Raises:
        OutputError: the folder is missing or not writable, or the target is something other than a file.
    """
    with output_errors(path):
        target = path.resolve()  # a symlink is kept: the file that it points to is replaced
        if target.is_dir():
            raise OutputError(f"{path}: is a directory; give the name of a file to write")
        if target.exists() and not target.is_file():
            raise OutputError(f"{path}: is not a regular file; give the name of a file to write")
        if not target.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {target.parent}; create it first")
        part = target.with_name(f"{target.name}.part")
        part.open("wb").close()
    try:
        with undone_at_once(partial(part.unlink, missing_ok=True)):
            yield part
            with output_errors(path):
                part.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):  # report the first error, not this one
            part.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn an OSError raised in the block into an OutputError about `path`."""
    try:
        yield
    except OSError as err:
        raise OutputError(f"{path}: cannot be written: {err.strerror or err}") from err
