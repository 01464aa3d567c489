"""Whether an output of a name can be written."""

from pathlib import Path

from pipeline.core.errors import OutputError
from writers.outputs.errors import output_errors

__all__ = ["resolved_output"]


def resolved_output(path: Path, *, is_folder: bool = False) -> Path:
    """The output without links: a link stays, and the file that it points to is replaced.

    Raises:
        OutputError: its folder is missing, it is a broken link, or something other than a file (a folder) stands there.
    """
    kind = "folder" if is_folder else "file"
    with output_errors(path):
        try:
            if path.is_symlink() and not path.exists():
                raise OutputError(f"{path}: is a link to {path.readlink()}, which does not exist; remove the link")
            target = path.resolve()
        except (ValueError, RuntimeError) as err:  # a null character; links in a circle
            raise OutputError(f"{path}: expected the name of a {kind} to write: {err}") from err
        if not target.parent.is_dir():
            raise OutputError(f"{path}: the folder {path.parent} does not exist; create it first")
        if target.is_dir() and not is_folder:
            raise OutputError(f"{path}: expected the name of a file to write, found a folder")
        if target.exists() and not target.is_file() and not target.is_dir():
            raise OutputError(f"{path}: is not a regular file; give the name of a {kind} to write")
        if target.is_file() and is_folder:
            raise OutputError(f"{path}: expected the name of a folder to write, found a file")
    return target
