"""The command line: what each command takes. It parses, checks what is wrong usage, and calls the command."""

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer

from lidcam.options import (
    STDOUT,
    AllowedDifference,
    AsJson,
    CompareConfigFile,
    ConfigFile,
    EvaluateConfigFile,
    EvaluateRigFile,
    Format,
    JsonCommand,
    JsonTarget,
    Overwrite,
    RecordingOut,
    Require,
    RigFile,
    Scenario,
    Seed,
    Setting,
    Version,
    seconds,
    with_log_options,
)
from pipeline.core.errors import LidcamError
from readers.location import RemotePath, location

__all__ = ["app", "process_app"]

# \b keeps the lines of a paragraph as they are.
PROCESS_EXAMPLES = """\b
Exit codes: 0 done, and nothing is missing; 1 failed, nothing was written (or
--strict or --require is not met, and the outputs are kept); 2 wrong usage;
3 done, but part of the recording could not be used. The last lines on stderr
say what.

\b
Examples:
  lidcam-process drive.bag out.mcap --rerun out.rrd
  lidcam-process bag_folder out.mcap --model-2d yolox_nano.onnx
  lidcam-process drive.bag out.mcap --rig site.yaml --start 30 --duration 10
  lidcam-process part_0.mcap part_1.mcap out.mcap --set sync.slop_s=0.05
  lidcam-process https://host/drive.mcap out.mcap --start 30 --duration 10
  lidcam-process drive.bag out.mcap --require "fused.car.recall > 0.8"
"""

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

EVALUATE_EXAMPLES = """\b
Exit codes: 0 done, and all requirements are met; 1 a requirement is not met,
with a line each, or nothing could be evaluated; 2 wrong usage; 3 done, but
part of the result is damaged.

\b
Examples:
  lidcam evaluate out.mcap
  lidcam evaluate out.mcap --truth drive.bag --json figures.json
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

CONFIG_EXAMPLES = """\b
Examples:
  lidcam config list
  lidcam config show sandbox
  lidcam config show road > mine.yaml
  lidcam config explain detect3d.cluster.distance_m
  lidcam config explain combine
"""
HELP_NAMES = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    context_settings=HELP_NAMES,
    help="Recorded lidar and camera topics in, fused objects out. No ROS installed.",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain text: the same on a terminal, in a log and in a file
    pretty_exceptions_enable=False,
)
process_app = typer.Typer(context_settings=HELP_NAMES, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog=PROCESS_EXAMPLES, cls=JsonCommand)
@process_app.command(epilog=PROCESS_EXAMPLES, cls=JsonCommand)
@with_log_options
def process(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="IN [IN ...] OUT.mcap",
            help="Recording (.bag, ROS 2 folder, .mcap, .db3, .pcap, or the URL of an .mcap), then output.",
        ),
    ],
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_files: RigFile = None,
    rerun: Annotated[Path | None, typer.Option(metavar="OUT.rrd", help="Also write a Rerun recording.")] = None,
    model_2d: Annotated[
        Path | None, typer.Option("--model-2d", metavar="FILE.onnx", help="2D detector (ONNX, YOLOX layout).")
    ] = None,
    start: Annotated[float, typer.Option(min=0, metavar="S", callback=seconds, help="Skip the first S seconds.")] = 0.0,
    duration: Annotated[
        float | None,
        typer.Option(min=0, metavar="S", callback=seconds, help="Process S seconds; without it, to the end."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="1: stage after stage; more: stages of several frames at once; without it, run.workers of the "
            "settings. The output is the same.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    on_bad_message: Annotated[
        Literal["skip", "fail"],
        typer.Option(help="What to do about a message that cannot be decoded, or a damaged file."),
    ] = "skip",
    copy_topics: Annotated[
        list[str] | None,
        typer.Option(
            "--copy-topics",
            metavar="PATTERN",
            help="Topics to copy to the output, as /map or '/ground_truth/*'; may be repeated. Without it, those of "
            "the truth.",
        ),
    ] = None,
    print_detections: Annotated[
        bool, typer.Option("--print-detections", help="Print what the lidars saw, frame by frame.")
    ] = False,
    print_matches: Annotated[
        bool, typer.Option("--print-matches", help="Print which 2D box is which object, frame by frame.")
    ] = False,
    json: JsonTarget = None,
    evaluate_: Annotated[
        bool, typer.Option("--evaluate", help="Then measure the result, as `lidcam evaluate` does.")
    ] = False,
    requirements: Require = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Exit with 1 if a sensor was left out or fell silent, too much of a topic was dropped, or a file is "
            "damaged; the outputs are kept.",
        ),
    ] = False,
    max_dropped: Annotated[
        float | None,
        typer.Option(
            "--max-dropped",
            min=0,
            max=100,
            metavar="PERCENT",
            help="How much of a topic, and of the frames of a sensor, may be missing with --strict.  [default: 5]",
        ),
    ] = None,
    _: Version = False,
) -> None:
    """Turn a recording into fused objects (MCAP, Rerun)."""
    if len(paths) < 2:
        raise typer.BadParameter("expected at least one recording and the output", param_hint="IN OUT.mcap")
    *inputs, output = map(location, paths)
    if isinstance(output, RemotePath):
        raise typer.BadParameter(f"the output is a local file, found {output}", param_hint="OUT.mcap")
    if output.suffix != ".mcap":
        raise typer.BadParameter(f"the output comes last and ends in .mcap, found {output}", param_hint="OUT.mcap")
    if rerun is not None and rerun.suffix != ".rrd":
        raise typer.BadParameter(f"expected a name that ends in .rrd, found {rerun}", param_hint="--rerun")
    if duration == 0:
        raise typer.BadParameter("expected more than 0 seconds", param_hint="--duration")
    if json == STDOUT and (print_detections or print_matches):
        raise typer.BadParameter(
            "prints one JSON document and nothing else: leave out --print-detections and --print-matches, or write it "
            "to a file with --json FILE.json",
            param_hint="--json",
        )
    if max_dropped is not None and not strict:
        raise typer.BadParameter("counts only with --strict, which is missing", param_hint="--max-dropped")
    if workers != 1:
        # Stages of several frames already fill the cores; OpenMP threads inside of one would only wait for each other.
        # Read once, when the libraries are loaded.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    from lidcam.commands.evaluate import requirement_errors  # heavy: after the arguments are known to be right
    from lidcam.commands.process import Printed, run_process
    from lidcam.commands.strict import Strictness
    from lidcam.evaluation.requirement import read_requirements
    from lidcam.job import make_job

    with requirement_errors():
        required = read_requirements(requirements or ())
    job = make_job(
        inputs,
        [output] if rerun is None else [output, rerun],
        config=config_file,
        settings=settings or (),
        rig=rig_files,
        model_2d=model_2d,
        copy_topics=copy_topics or None,
        workers=workers,
        start_s=start,
        duration_s=duration,
        on_bad_message=on_bad_message,
        overwrite=overwrite,
    )
    printed = Printed(detections=print_detections, matches=print_matches, json=json)
    given = {} if max_dropped is None else {"max_dropped_percent": max_dropped}
    with requirement_errors():
        run_process(
            job, printed, Strictness(**given) if strict else None, required if evaluate_ or requirements else None
        )


@app.command(epilog=INSPECT_EXAMPLES)
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


@app.command(epilog=EVALUATE_EXAMPLES, cls=JsonCommand)
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
    json: JsonTarget = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure a result: against truth, and without it.

    Detection, calibration of scores, gain by fusion, tracks; by class, range
    and zone.
    """
    from lidcam.commands.evaluate import EvaluateOptions, requirement_errors, run_evaluate
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
        run_evaluate(EvaluateOptions(job, json, overwrite, (*read_files(config_file, rig_files), *gates)))


@app.command(epilog=COMPARE_EXAMPLES, cls=JsonCommand)
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
    json: JsonTarget = None,
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
            json=json,
            overwrite=overwrite,
            read_files=read_files(config_file, None),
        )
    )


@app.command()
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
    from lidcam.commands.demo import run_demo

    run_demo(folder, overwrite=overwrite)


@app.command(epilog=SIMULATE_EXAMPLES)
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


@app.command(epilog=DRIVE_EXAMPLES)
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


config_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, epilog=CONFIG_EXAMPLES
)
app.add_typer(config_app, name="config", help="The presets, and what the settings mean.")


@config_app.command("list")
@with_log_options
def config_list(as_json: AsJson = False) -> None:
    """List the presets."""
    from lidcam.commands.config import run_list

    run_list(as_json=as_json)


@config_app.command("show")
@with_log_options
def config_show(
    name: Annotated[str, typer.Argument(metavar="PRESET|FILE", help="sandbox, crossing, road, or a YAML file.")],
    changes: Annotated[bool, typer.Option("--changes", help="Only what differs from the defaults.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print all settings of a preset or a file, as YAML to copy."""
    from lidcam.commands.config import run_show

    run_show(name, changes=changes, as_json=as_json)


@config_app.command("explain")
@with_log_options
def config_explain(
    key: Annotated[str, typer.Argument(metavar="KEY", help="A setting or a section; without it, the sections.")] = "",
    as_json: AsJson = False,
) -> None:
    """Explain a setting.

    Its meaning, unit, allowed values, default, and its value in each preset.
    """
    from lidcam.commands.config import run_explain

    run_explain(key, as_json=as_json)


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


@app.callback()
def _common(_: Version = False) -> None:
    pass
