"""The command `lidcam evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.cli.options import (
    AsJson,
    JsonFile,
    Overwrite,
    Require,
    Setting,
    Truth,
    option,
    requirement_errors,
    with_log_options,
)
from lidcam.cli.printing.log import is_verbose
from lidcam.cli.verdict import Verdict

EVALUATE_EXAMPLES = """\
Exit codes: 0 done, all requirements met; 1 a requirement is not met, or
nothing could be evaluated; 2 wrong usage; 3 done, but part of the result is
damaged.

\b
Examples:
  lidcam evaluate out.mcap
  lidcam evaluate out.mcap --truth drive.bag --json-file figures.json
  lidcam evaluate out.mcap --require "fused.car.recall >= 0.8"
  lidcam evaluate out.mcap --require @gate.txt
  lidcam evaluate out.mcap --set evaluate.max_range_m=40
"""


@with_log_options
def evaluate(
    result: Annotated[Path, typer.Argument(metavar="RESULT.mcap", help="What `lidcam process` wrote.")],
    truth: Truth = None,
    truth_topic: Annotated[
        str, option("Ground-truth topic. Default: found by name.", metavar="TOPIC", show_default=False)
    ] = "",
    requirements: Require = None,
    rig_files: Annotated[
        list[str] | None,
        option("Rig file to take zones and ground-truth vehicles from. May be repeated.", "--rig", metavar="FILE"),
    ] = None,
    settings: Setting = None,
    everything: Annotated[
        bool, option("Print all tables: each source, errors, tracks, gain, worst errors.", "--all")
    ] = False,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Evaluate a result, with and without ground truth.

    Detection, calibration of scores, gain from fusion, tracks; by class, range and zone.
    """
    from lidcam.cli.json_output import figures_document, json_output
    from lidcam.cli.printing.evaluation import print_evaluation
    from lidcam.cli.printing.progress import show_progress
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.evaluation.evaluate import evaluate_result
    from lidcam.evaluation.evaluation import make_evaluation_job
    from lidcam.run.job import read_files

    with requirement_errors():
        job = make_evaluation_job(
            result,
            truth=truth or (),
            truth_topic=truth_topic,
            requirements=requirements or (),
            rig=rig_files,
            settings=settings or (),
        )
        gates = [Path(one[1:]) for one in requirements or () if one.startswith("@")]
        inputs = (job.result, *job.truth, *read_files(None, rig_files), *gates)
        with json_output(json_file, inputs=inputs, overwrite=overwrite) as write_json:
            evaluation = evaluate_result(job, show_progress)
            verdict = Verdict(evaluation.failures, evaluation.incomplete)
            tree = figures_document(
                "evaluate",
                inputs=evaluation.inputs,
                settings={"name": evaluation.settings_name, "sha256": evaluation.settings_sha256},
                truth=evaluation.truth.tree() if evaluation.truth else None,
                figures=evaluation.tree(),
                verdict=verdict,
                warnings=evaluation.warnings,
                notes=evaluation.notes,
            )
            write_json(tree)
    if as_json:
        show_json(console(), tree)
    else:
        print_evaluation(console(), evaluation, everything=everything or is_verbose())
    verdict.end()
