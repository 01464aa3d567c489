"""The command line: parses, runs a command, turns known errors into one line; the only place that exits.

Exit codes: 0 done; 1 the input, the calibration or a check failed, with one line on stderr; 2 wrong usage; anything
else is a bug and shows its traceback. Results go to stdout, progress and log to stderr.
"""

import logging
import os
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import typer

from pipeline.errors import LidcamError

__all__ = ["app", "main", "main_process"]

PROCESS_EXAMPLES = """
Examples:

  lidcam-process drive.bag out.mcap --rerun out.rrd

  lidcam-process bag_folder out.mcap --model-2d yolox_nano.onnx --rig site.yaml

  lidcam-process part_0.mcap part_1.mcap out.mcap --start 30 --duration 10 --set combine.outliers.enabled=false
"""

app = typer.Typer(
    help="Recorded lidar and camera topics in, fused objects out. No ROS installed.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

ConfigFile = Annotated[Path | None, typer.Option("--config", metavar="FILE", help="Pipeline settings (YAML).")]
Setting = Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="One setting; may be repeated.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="Sensors, calibration and zones (rig YAML, the original's geometry.yaml, or a KITTI calib file); "
        "without it they are found in the recording.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.command(epilog=PROCESS_EXAMPLES)
def process(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN [IN ...] OUT.mcap", help="Recording (.bag, ROS 2 folder, .mcap, .db3), then output."
        ),
    ],
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_file: RigFile = None,
    rerun: Annotated[Path | None, typer.Option(metavar="OUT.rrd", help="Also write a Rerun recording.")] = None,
    model_2d: Annotated[
        Path | None, typer.Option("--model-2d", metavar="FILE.onnx", help="2D detector (ONNX, YOLOX layout).")
    ] = None,
    start: Annotated[float, typer.Option(min=0, metavar="S", help="Skip the first S seconds.")] = 0.0,
    duration: Annotated[float | None, typer.Option(min=0, metavar="S", help="Process S seconds.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="1: stage after stage.")] = None,
    on_bad_message: Annotated[
        Literal["skip", "fail"], typer.Option(help="What to do about a message that cannot be decoded.")
    ] = "skip",
    print_detections: Annotated[bool, typer.Option(help="Print what the lidars saw, frame by frame.")] = False,
    print_matches: Annotated[bool, typer.Option(help="Print which 2D box is which object, frame by frame.")] = False,
    as_json: AsJson = False,
) -> None:
    """Turn a recording into fused objects: an MCAP, and a Rerun recording on demand."""
    if len(paths) < 2:
        raise typer.BadParameter("expected at least one recording and the output", param_hint="IN OUT.mcap")
    *inputs, output = paths
    if output.suffix != ".mcap":
        raise typer.BadParameter(f"the output comes last and ends in .mcap, found {output}", param_hint="OUT.mcap")
    if rerun is not None and rerun.suffix != ".rrd":
        raise typer.BadParameter(f"expected a name that ends in .rrd, found {rerun}", param_hint="--rerun")
    overrides = list(settings or ())
    if workers is not None:
        overrides.append(f"run.workers={workers}")
    if workers != 1:
        # Stages of several frames already fill the cores; OpenMP threads inside of one would only wait for each other.
        # Read once, when the libraries are loaded.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    from pipeline.commands import ProcessOptions, run_process  # heavy: after the arguments are known to be right

    options = ProcessOptions(
        inputs=tuple(inputs),
        output=output,
        rerun=rerun,
        config_file=config_file,
        overrides=tuple(overrides),
        rig_file=rig_file,
        model_2d=model_2d,
        start_s=start,
        duration_s=duration,
        on_bad_message=on_bad_message,
        print_detections=print_detections,
        print_matches=print_matches,
        as_json=as_json,
    )
    run_process(options)


@app.command(
    epilog="Examples:\n\n  lidcam inspect drive.bag\n\n  lidcam inspect drive.bag --write-rig rig.yaml\n\n"
    "  lidcam inspect bag_folder --json"
)
def inspect(
    paths: Annotated[list[Path], typer.Argument(metavar="IN [IN ...]", help="Recording (one, or parts of one).")],
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_file: RigFile = None,
    write_rig: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a starting rig (YAML).")] = None,
    as_json: AsJson = False,
) -> None:
    """Tell what is in a recording: topics, types, rates, gaps, calibration, and what lidcam would use."""
    from pipeline.commands import InspectOptions, run_inspect

    run_inspect(
        InspectOptions(
            inputs=tuple(paths),
            config_file=config_file,
            overrides=tuple(settings or ()),
            rig_file=rig_file,
            write_rig=write_rig,
            as_json=as_json,
        )
    )


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lidcam {version('lidcam')}")
        raise typer.Exit


@app.callback()
def _common(
    _: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")] = False,
) -> None:
    pass


def main() -> None:
    """The program `lidcam`."""
    _run(app, sys.argv[1:])


def main_process() -> None:
    """The program `lidcam-process`: `lidcam process`."""
    _run(app, ["process", *sys.argv[1:]])


def _run(program: Callable[..., object], arguments: list[str]) -> None:
    logging.basicConfig(level=logging.WARNING, format="lidcam: %(message)s", stream=sys.stderr)
    try:
        program(arguments, prog_name="lidcam")
    except LidcamError as err:
        sys.stderr.write(f"lidcam: error: {' '.join(str(err).split())}\n")
        for note in getattr(err, "__notes__", ()):
            sys.stderr.write(f"  {note}\n")
        sys.exit(1)
