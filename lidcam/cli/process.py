"""What `lidcam process` takes."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lidcam.options import (
    AsJson,
    ConfigFile,
    JsonFile,
    Overwrite,
    Require,
    RigFile,
    Setting,
    Version,
    seconds,
    with_log_options,
)
from lidcam.start.compiling import compiled_together
from pipeline.parallel.cores import THREADS_OF_LIBRARIES
from readers.location import RemotePath, location

if TYPE_CHECKING:
    from lidcam.evaluation.requirement import Requirement

__all__ = ["PROCESS_EXAMPLES", "process"]

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
        Path | None,
        typer.Option("--model-2d", metavar="FILE.onnx", help="2D detector (ONNX)."),
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
            help="Processes that share the frames; without it, run.workers of the settings, else one per core. The "
            "output is the same.",
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
        bool, typer.Option("--print-detections", help="Print what each sensor and the fusion found, frame by frame.")
    ] = False,
    print_matches: Annotated[
        bool, typer.Option("--print-matches", help="Print which 2D box is which object, frame by frame.")
    ] = False,
    as_json: AsJson = False,
    json_file: JsonFile = None,
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
    if as_json and (print_detections or print_matches):
        raise typer.BadParameter(
            "prints one JSON document and nothing else: leave out --print-detections and --print-matches, or write it "
            "to a file with --json-file FILE.json",
            param_hint="--json",
        )
    if max_dropped is not None and not strict:
        raise typer.BadParameter("counts only with --strict, which is missing", param_hint="--max-dropped")
    if workers != 1:
        # Processes already fill the cores; threads of libraries inside of one would only wait for each other.
        # Read once, when the libraries are loaded.
        for name in THREADS_OF_LIBRARIES:
            os.environ.setdefault(name, "1")
    with compiled_together(shown=True):  # heavy: after the arguments are known to be right
        from lidcam.commands.process import Printed, run_process
    from lidcam.commands.requirement_errors import requirement_errors
    from lidcam.commands.strict import Strictness
    from lidcam.job import make_job

    required: Sequence[Requirement] = ()
    if requirements:
        from lidcam.evaluation.requirement import read_requirements

        with requirement_errors():
            required = read_requirements(requirements)
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
    printed = Printed(detections=print_detections, matches=print_matches, as_json=as_json, json_file=json_file)
    given = {} if max_dropped is None else {"max_dropped_percent": max_dropped}
    with requirement_errors():
        run_process(
            job, printed, Strictness(**given) if strict else None, required if evaluate_ or requirements else None
        )
