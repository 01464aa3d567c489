"""Arguments of `lidcam inspect`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.options import AsJson, ConfigFile, Overwrite, RigFile, Setting, with_log_options
from readers.location import location

__all__ = ["INSPECT_EXAMPLES", "inspect"]

# \b keeps the lines of a paragraph as they are.
INSPECT_EXAMPLES = """\b
Exit codes: 0 sound, and all sensors can be used; 3 messages are lost, or
sensors would be left out; 1 nothing can be processed; 2 wrong usage. With
--repair, 0 says that every message was copied.

\b
Examples:
  lidcam inspect drive.bag
  lidcam inspect drive.bag --write-rig rig.yaml
  lidcam inspect bag_folder --json
  lidcam inspect broken.bag --repair whole.mcap
  lidcam inspect s3://bucket/drive.mcap
"""


@with_log_options
def inspect(
    paths: Annotated[list[str], typer.Argument(metavar="IN [IN ...]", help="Recording (one, or parts of one).")],
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_files: RigFile = None,
    write_rig: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a starting rig (YAML).")] = None,
    repair: Annotated[
        Path | None,
        typer.Option(metavar="OUT.mcap", help="Write every message that can still be read to a clean MCAP."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Show what is in a recording and what lidcam would use.

    Topics, types, rates, gaps, sensors, where their calibration comes from, and what is damaged.
    """
    if repair is not None and repair.suffix != ".mcap":
        raise typer.BadParameter(f"expected a name that ends in .mcap, found {repair}", param_hint="--repair")
    from lidcam.commands.inspect import InspectOptions, run_inspect
    from lidcam.job import read_files
    from lidcam.settings.choice import choose_settings

    run_inspect(
        InspectOptions(
            inputs=tuple(map(location, paths)),
            settings=choose_settings(config_file, settings or ()),
            rig=rig_files,
            write_rig=write_rig,
            repair=repair,
            overwrite=overwrite,
            as_json=as_json,
            read_files=read_files(config_file, rig_files),
        )
    )
