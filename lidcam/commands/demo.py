"""What `lidcam demo` does."""

import filecmp
import shutil
import sys
from pathlib import Path

import bags
from lidcam.commands.process import run_process
from lidcam.job import make_job
from lidcam.outputs.allowed import SIMULATED, check_replaced
from lidcam.printing.terminal import console
from pipeline.core.errors import OutputError
from writers.outputs.transaction import OutputTransaction

__all__ = ["run_demo"]

SAMPLE = Path(bags.__file__).with_name("sandbox.bag")


def run_demo(folder: Path, *, overwrite: bool = False) -> None:
    """Process the sample recording into a folder, and say how to look at the result.

    Args:
        folder: It is made if it does not exist.
        overwrite: Replace files that are neither the sample nor results of earlier runs, too.

    Raises:
        LidcamError: the folder cannot be written.
    """
    recording = folder / SAMPLE.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _copy_sample(recording, overwrite=overwrite)  # to be tried out with other commands
    except OSError as err:
        raise OutputError(
            f"{folder}: expected a folder to write to: {err.strerror or err}; choose another one"
        ) from err
    mcap, rerun = recording.with_suffix(".mcap"), recording.with_suffix(".rrd")
    run_process(make_job(recording, [mcap, rerun], config="sandbox", overwrite=overwrite))
    out = console()
    out.print()
    for line in _remarks(recording, mcap, rerun):
        out.print(line)


def _copy_sample(path: Path, *, overwrite: bool) -> None:
    if path.is_file() and filecmp.cmp(SAMPLE, path, shallow=False):
        return
    with OutputTransaction([path], check_old=check_replaced(lambda _: SIMULATED, overwrite=overwrite)) as outputs:
        shutil.copyfile(SAMPLE, outputs[path].part)


def _remarks(recording: Path, mcap: Path, rerun: Path) -> list[str]:
    layout = mcap.with_suffix(".foxglove.json")
    remarks = [
        "Look at it:",
        f"  {_program('rerun')} {rerun}",
        f"  or in Foxglove or Lichtblick: Open local file, {mcap}",
    ]
    if layout.is_file():
        remarks.append(f"    with the layout {layout}")
    return [*remarks, "What was processed:", f"  {_program('lidcam')} inspect {recording}"]


def _program(name: str) -> str:
    """How the user calls a program that was installed with lidcam: by its name only if that is the one."""
    path = str(Path(sys.executable).with_name(name))
    return name if shutil.which(name) == path else path
