"""The command `lidcam demo`."""

import filecmp
from pathlib import Path
from typing import Annotated

import typer

from lidcam.bags import SAMPLE
from lidcam.cli.options import Overwrite, with_log_options
from lidcam.cli.process import made_folder, run_process
from lidcam.outputs.registry import usual_endings


@with_log_options
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for the recording and the outputs.")] = Path(
        "lidcam-demo"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Process the bundled sample recording.

    Writes an MCAP, a Rerun recording and a page into a folder.
    """
    from lidcam.cli.printing.terminal import console, show_line
    from lidcam.outputs.allowed import SIMULATED, check_replaced
    from lidcam.run.job import make_job
    from lidcam.writers.outputs.transaction import OutputTransaction

    recording = folder / SAMPLE.name
    check_old = check_replaced(lambda _: SIMULATED, overwrite=overwrite)
    with made_folder(folder):
        if not (recording.is_file() and filecmp.cmp(SAMPLE, recording, shallow=False)):
            with OutputTransaction([recording], check_old=check_old) as copied:  # to be tried out with other commands
                copied[recording].write_bytes(SAMPLE.read_bytes())
        outputs = [recording.with_suffix(ending) for ending in usual_endings()]
        run_process(make_job(recording, outputs, config="sandbox", overwrite=overwrite))
    show_line(console(), f"processed: {recording}; lidcam inspect {recording} shows what is in it")
