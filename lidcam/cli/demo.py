"""The command `lidcam demo`."""

import filecmp
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

import lidcam.bags
from lidcam.cli.options import Overwrite, with_log_options
from lidcam.cli.process import run_process
from lidcam.pipeline.core.errors import OutputError

SAMPLE = Path(lidcam.bags.__file__).with_name("sandbox.bag")


@with_log_options
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for the recording and the outputs.")] = Path(
        "lidcam-demo"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Process the bundled sample recording.

    Writes to a folder; the last lines tell how to open the outputs.
    """
    from lidcam.cli.printing.terminal import console
    from lidcam.run.job import make_job

    recording = folder / SAMPLE.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _copy_sample(recording, overwrite=overwrite)  # to be tried out with other commands
    except OSError as err:
        raise OutputError(
            f"{folder}: expected a folder to write to: {err.strerror or err}; choose another one"
        ) from err
    mcap, rerun = recording.with_suffix(".mcap"), recording.with_suffix(".rrd") if find_spec("rerun") else None
    run_process(make_job(recording, [mcap, rerun] if rerun else mcap, config="sandbox", overwrite=overwrite))
    out = console()
    out.print()
    for line in _remarks(recording, mcap, rerun):
        out.print(line)


def _copy_sample(path: Path, *, overwrite: bool) -> None:
    from lidcam.outputs.allowed import SIMULATED, check_replaced
    from lidcam.writers.outputs.transaction import OutputTransaction

    if path.is_file() and filecmp.cmp(SAMPLE, path, shallow=False):
        return
    with OutputTransaction([path], check_old=check_replaced(lambda _: SIMULATED, overwrite=overwrite)) as outputs:
        shutil.copyfile(SAMPLE, outputs[path].part)


def _remarks(recording: Path, mcap: Path, rerun: Path | None) -> list[str]:
    layout = mcap.with_suffix(".foxglove.json")
    remarks = [
        "Look at it:",
        *([f"  {_program('rerun')} {rerun}"] if rerun else []),
        f"  {'or ' if rerun else ''}in Foxglove or Lichtblick: Open local file, {mcap}",
    ]
    if layout.is_file():
        remarks.append(f"    with the layout {layout}")
    return [*remarks, "What was processed:", f"  {_program('lidcam')} inspect {recording}"]


def _program(name: str) -> str:
    """The command for a program that was installed with lidcam: its name if that is on the path, else its path."""
    path = str(Path(sys.executable).with_name(name))
    return name if shutil.which(name) == path else path
