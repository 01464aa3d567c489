"""Arguments of `lidcam simulate` and `lidcam drive`."""

from importlib.util import find_spec
from typing import Annotated

import typer

from lidcam.options import Format, Overwrite, RecordingOut, Scenario, Seed, Setting, seconds, with_log_options
from pipeline.core.errors import LidcamError

__all__ = ["DRIVE_EXAMPLES", "SIMULATE_EXAMPLES", "drive", "simulate"]

# \b keeps the lines of a paragraph as they are.
SIMULATE_EXAMPLES = """\b
Scenarios: sandbox, crossing, vehicle, or a YAML file of your own.
Examples:
  lidcam simulate sandbox out.bag --duration 10
  lidcam simulate crossing out.mcap --seed 7
  lidcam simulate my_crossing.yaml bag_folder --format sqlite3
  lidcam simulate sandbox out.bag --set lidars.velodyne1.clock_offset_ms=20
"""

DRIVE_EXAMPLES = """\b
Keys: w forward, s back, a left, d right, x stop, 1 and 2 choose the car,
o ends. A command holds until the next one.
Examples:
  lidcam drive sandbox out.bag --view
  lidcam drive sandbox out.mcap --keys "wwadx2ww"
"""


@with_log_options
def simulate(
    scenario: Scenario,
    output: RecordingOut,
    format_: Format = None,
    duration: Annotated[
        float | None,
        typer.Option(min=0, metavar="S", callback=seconds, help="Seconds to record; without it, the scenario's."),
    ] = None,
    seed: Seed = None,
    settings: Setting = None,
    overwrite: Overwrite = False,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Sensors simulated at once; the recording is the same. [default: cores]"),
    ] = None,
) -> None:
    """Record a simulated scene.

    Lidars, cameras, and the truth about what they see.
    """
    if duration == 0:
        raise typer.BadParameter("expected more than 0 seconds", param_hint="--duration")
    _check_simulator()
    from lidcam.commands.simulate import SimulateOptions, run_simulate

    options = SimulateOptions(
        scenario=scenario,
        output=output,
        format=format_,
        duration_s=duration,
        seed=seed,
        overrides=tuple(settings or ()),
        overwrite=overwrite,
        workers=workers,
    )
    run_simulate(options)


@with_log_options
def drive(
    scenario: Scenario,
    output: RecordingOut,
    format_: Format = None,
    keys: Annotated[
        str | None,
        typer.Option(
            metavar="KEYS", help="Press these keys one after another, as fast as the simulation runs, and end."
        ),
    ] = None,
    key_interval: Annotated[
        float, typer.Option(min=0.01, max=60, metavar="S", help="Simulated seconds from one of --keys to the next.")
    ] = 0.5,
    view: Annotated[bool, typer.Option("--view", help="Show it in the Rerun viewer meanwhile.")] = False,
    duration: Annotated[
        float | None, typer.Option(min=0, metavar="S", callback=seconds, help="End after S simulated seconds.")
    ] = None,
    seed: Seed = None,
    settings: Setting = None,
    overwrite: Overwrite = False,
) -> None:
    """Drive the cars of a scenario from the keyboard, and record it."""
    if duration == 0:
        raise typer.BadParameter("expected more than 0 seconds", param_hint="--duration")
    _check_simulator()
    from lidcam.commands.drive import DriveOptions, run_drive

    options = DriveOptions(
        scenario=scenario,
        output=output,
        format=format_,
        duration_s=duration,
        seed=seed,
        overrides=tuple(settings or ()),
        overwrite=overwrite,
        keys=keys,
        key_interval_s=key_interval,
        view=view,
    )
    run_drive(options)


def _check_simulator() -> None:
    """Whether the extra `sim` is installed, and the libraries of the system that it needs.

    Raises:
        LidcamError: something is missing.
    """
    for package in ("open3d", "libusb_package"):
        if find_spec(package) is None:
            raise LidcamError(f"the simulator needs {package}, which is not installed: pip install 'lidcam[sim]'")
    from bags.simulator.world.open3d_runtime import check_libraries

    check_libraries()
