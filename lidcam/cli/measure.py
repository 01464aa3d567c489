"""What `lidcam evaluate` and `lidcam compare` take."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.options import (
    AllowedDifference,
    AsJson,
    CompareConfigFile,
    EvaluateConfigFile,
    EvaluateRigFile,
    JsonFile,
    Overwrite,
    Require,
    Setting,
    with_log_options,
)

__all__ = ["COMPARE_EXAMPLES", "EVALUATE_EXAMPLES", "compare", "evaluate"]

# \b keeps the lines of a paragraph as they are.
EVALUATE_EXAMPLES = """\b
Exit codes: 0 done, and all requirements are met; 1 a requirement is not met,
with a line each, or nothing could be evaluated; 2 wrong usage; 3 done, but
part of the result is damaged.

\b
Examples:
  lidcam evaluate out.mcap
  lidcam evaluate out.mcap --truth drive.bag --json-file figures.json
  lidcam evaluate out.mcap --require "fused.car.recall >= 0.8"
  lidcam evaluate out.mcap --require @gate.txt
  lidcam evaluate out.mcap --set evaluate.max_range_m=40
"""

COMPARE_EXAMPLES = """\b
Exit codes: 0 equal within the tolerances, or as far as is allowed; 1 they
differ more, or cannot be compared; 2 wrong usage; 3 equal, but a file is
damaged.

\b
Examples:
  lidcam compare golden.mcap new.mcap
  lidcam compare golden.mcap new.mcap --only fused --max-different 1
  lidcam compare golden.mcap new.mcap --set compare.yaw_deg=5 --allow rescored
  lidcam compare golden.mcap new.mcap --merged both.mcap
"""


@with_log_options
def evaluate(
    result: Annotated[Path, typer.Argument(metavar="RESULT.mcap", help="What `lidcam process` wrote.")],
    truth: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH",
            help="A recording with topics of truth, or labels; without it, what was copied into the result. May be "
            "repeated.",
        ),
    ] = None,
    truth_topic: Annotated[
        str,
        typer.Option(
            metavar="TOPIC", help="The topic of the truth; without it, the one that is called so.", show_default=False
        ),
    ] = "",
    requirements: Require = None,
    rig_files: EvaluateRigFile = None,
    config_file: EvaluateConfigFile = None,
    settings: Setting = None,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure a result: against truth, and without it.

    Detection, calibration of scores, gain by fusion, tracks; by class, range
    and zone.
    """
    from lidcam.commands.evaluate import EvaluateOptions, run_evaluate
    from lidcam.commands.requirement_errors import requirement_errors
    from lidcam.evaluation.evaluation import make_evaluation_job
    from lidcam.job import read_files

    with requirement_errors():
        job = make_evaluation_job(
            result,
            truth=truth or (),
            truth_topic=truth_topic,
            requirements=requirements or (),
            rig=rig_files,
            config=config_file,
            settings=settings or (),
        )
        gates = tuple(Path(one[1:]) for one in requirements or () if one.startswith("@"))
        run_evaluate(EvaluateOptions(job, as_json, json_file, overwrite, (*read_files(config_file, rig_files), *gates)))


@with_log_options
def compare(
    first: Annotated[Path, typer.Argument(metavar="A.mcap", help="A result of process.")],
    second: Annotated[Path, typer.Argument(metavar="B.mcap", help="Another one, of the same recording or scene.")],
    config_file: CompareConfigFile = None,
    settings: Setting = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help="A source (fused, lidar, cameras) or camera; without it, all. May be repeated.",
        ),
    ] = None,
    allow: Annotated[
        list[AllowedDifference] | None,
        typer.Option(
            "--allow",
            metavar="KIND",
            help="What may differ, however much: lost, new, moved, turned, resized, relabelled, rescored, reidentified "
            "(objects) or frames (of one result alone). May be repeated.",
        ),
    ] = None,
    max_different: Annotated[
        float,
        typer.Option(
            "--max-different",
            min=0,
            max=100,
            metavar="PERCENT",
            help="How many of the objects of a source or camera, and of the frames, may differ.",
        ),
    ] = 0.0,
    lines: Annotated[int, typer.Option("--lines", min=0, metavar="N", help="Differences that are printed.")] = 10,
    merged: Annotated[
        Path | None,
        typer.Option(metavar="OUT.mcap", help="Also write both into one file, to look at them side by side."),
    ] = None,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Show what differs between two results, object by object.

    Objects that are lost, new, moved, turned, resized, relabelled, rescored, or go on under another id; B against A.
    """
    if merged is not None and merged.suffix != ".mcap":
        raise typer.BadParameter(f"expected a name that ends in .mcap, found {merged}", param_hint="--merged")
    from lidcam.commands.compare import CompareOptions, run_compare
    from lidcam.job import read_files
    from lidcam.settings.effect import COMPARING, check_effect
    from pipeline.core.settings.load import load_config

    check_effect(settings or (), COMPARING)
    run_compare(
        CompareOptions(
            first=first,
            second=second,
            config=load_config(config_file, settings or ()),
            settings_name=config_file or "defaults",
            only=tuple(only or ()),
            allowed=tuple(allow or ()),
            max_different_percent=max_different,
            lines=lines,
            merged=merged,
            as_json=as_json,
            json_file=json_file,
            overwrite=overwrite,
            read_files=read_files(config_file, None),
        )
    )
