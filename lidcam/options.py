"""Arguments and options that several commands have in common."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import typer

__all__ = [
    "AsJson",
    "ConfigFile",
    "Format",
    "RecordingOut",
    "RigFile",
    "Scenario",
    "Seed",
    "Setting",
    "Version",
    "seconds",
]

MAX_SECONDS = 1e9
"""Thirty years: longer than any recording, and well within 64 bits of nanoseconds."""


def seconds(value: float | None) -> float | None:
    """Refuse times that no recording has.

    Raises:
        typer.BadParameter: the value is too large or not a number.
    """
    if value is not None and not value <= MAX_SECONDS:
        raise typer.BadParameter(f"expected at most {MAX_SECONDS:.0f} seconds, found {value}")
    return value


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lidcam {version('lidcam')}")
        raise typer.Exit


Version = Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="PRESET|FILE",
        help="Settings: sandbox, crossing, road, or a YAML file; without it, what suits the recording.",
    ),
]
Setting = Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="One setting; may be repeated.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="Sensors, calibration and zones (rig YAML, a geometry.yaml with w2c and c2p, or a KITTI calib file); "
        "without it they are found in the recording.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Scenario = Annotated[str, typer.Argument(metavar="SCENARIO", help="Name of a scenario, or a YAML file.")]
RecordingOut = Annotated[Path, typer.Argument(metavar="OUT", help="OUT.bag, OUT.mcap, or a folder (sqlite3).")]
Format = Annotated[
    Literal["ros1", "sqlite3", "mcap"] | None,
    typer.Option("--format", help="Format of the recording; without it, the ending of its name decides."),
]
Seed = Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed of the noise, instead of the scenario's.")]
