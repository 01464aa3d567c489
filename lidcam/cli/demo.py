"""The command `lidcam demo`."""

import filecmp
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from lidcam.bags import SAMPLE
from lidcam.cli.options import Overwrite, with_log_options
from lidcam.cli.process import made_folder, run_process
from lidcam.pipeline.core.errors import OutputError


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
    from lidcam.run.job import make_job

    recording = folder / SAMPLE.name
    with made_folder(folder):
        try:
            _copy_sample(recording, overwrite=overwrite)  # to be tried out with other commands
        except OSError as err:
            raise OutputError(f"{folder}: cannot write there: {err.strerror or err}; choose another folder") from err
        endings = (".mcap", *[".rrd"] * (find_spec("rerun") is not None), ".html")
        outputs = [recording.with_suffix(ending) for ending in endings]
        run_process(make_job(recording, outputs, config="sandbox", overwrite=overwrite))
    show_line(console(), f"processed: {recording}; lidcam inspect {recording} shows what is in it")


def _copy_sample(path: Path, *, overwrite: bool) -> None:
    from lidcam.outputs.allowed import SIMULATED, check_replaced
    from lidcam.writers.outputs.transaction import OutputTransaction

    if path.is_file() and filecmp.cmp(SAMPLE, path, shallow=False):
        return
    with OutputTransaction([path], check_old=check_replaced(lambda _: SIMULATED, overwrite=overwrite)) as outputs:
        shutil.copyfile(SAMPLE, outputs[path].part)
