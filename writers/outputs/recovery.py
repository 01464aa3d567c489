"""What a killed run has left: outputs that were being exchanged are completed or put back, the rest is removed."""

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from writers.outputs.exchange import has_journal, read_journal, resume
from writers.outputs.work_folder import BusyError, WorkFolder, Writing, work_folder_path

__all__ = ["recover"]


def recover(folder: WorkFolder, held: Mapping[Path, WorkFolder]) -> None:
    """Go on with the exchange in which an output was when its run was killed, and clean up after that run.

    Args:
        folder: The work folder of the output.
        held: All work folders that are locked, by their outputs.

    Raises:
        OSError: the folders cannot be read.
        OutputError: outputs have to be put back and the system refuses, or another run has one of them.
    """
    if folder.left_by is None:
        return
    outputs = folder.left_by.outputs
    home = work_folder_path(outputs[0])
    with ExitStack() as stack:
        for target in outputs:
            if target in held or not work_folder_path(target).is_dir():
                continue
            try:
                other = WorkFolder(target, target)
            except BusyError:
                if folder.target in [one.target for one in read_journal(home)]:
                    raise
                continue  # a later run; it has cleaned up
            stack.callback(_close, other, folder.left_by, home)
        exchanges = read_journal(home)
        if folder.target in [one.target for one in exchanges]:
            with suppress(OSError):  # what can no longer be completed was put back
                resume(home, exchanges)


def _close(other: WorkFolder, left_by: Writing, home: Path) -> None:
    """Remove the work folder of another output if the same run has left it, and nothing is to be done with it."""
    other.close(is_done=(other.is_new or other.left_by == left_by) and not has_journal(home))
