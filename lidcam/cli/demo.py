"""Arguments of `lidcam demo`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.options import Overwrite, with_log_options
from lidcam.start.compiling import compiled_together

__all__ = ["demo"]


@with_log_options
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for the recording and the outputs.")] = Path(
        "lidcam-demo"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Process the bundled sample recording.

    The output goes to a folder; the last lines say how to open it.
    """
    with compiled_together(shown=True):
        from lidcam.commands.demo import run_demo

    run_demo(folder, overwrite=overwrite)
