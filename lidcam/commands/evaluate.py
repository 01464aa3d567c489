"""The work of `lidcam evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.commands.envelope import envelope
from lidcam.commands.json_output import json_output
from lidcam.commands.verdict import Verdict
from lidcam.evaluation.evaluate import evaluate_result
from lidcam.evaluation.evaluation import Evaluation, EvaluationJob
from lidcam.printing.evaluation import print_evaluation
from lidcam.printing.progress import show_progress
from lidcam.printing.terminal import console

__all__ = ["EvaluateOptions", "run_evaluate"]


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """The command line of `evaluate`.

    Attributes:
        job: What to evaluate, and against what.
        as_json: Print JSON in place of the tables.
        json_file: Where the JSON is written; None: nowhere.
        overwrite: Replace what no earlier run wrote, too.
        read_files: Files that were read for the settings, the rig and the requirements.
    """

    job: EvaluationJob
    as_json: bool = False
    json_file: Path | None = None
    overwrite: bool = False
    read_files: tuple[Path, ...] = ()


def run_evaluate(options: EvaluateOptions) -> None:
    """Evaluate a result and print the figures.

    Raises:
        CheckError: a requirement is not met.
        IncompleteError: part of the result or of the truth could not be used.
        LidcamError: the result, the truth or the settings are at fault.
    """
    job = options.job
    inputs = (job.result, *job.truth, *options.read_files)
    with json_output(options.json_file, is_printed=options.as_json, inputs=inputs, overwrite=options.overwrite) as json:
        evaluation = evaluate_result(job, show_progress)
        verdict = Verdict(evaluation.failures, evaluation.incomplete)
        json.tree = _tree(evaluation, verdict)
    out = console()
    json.show(out, lambda: print_evaluation(out, evaluation))
    verdict.end()


def _tree(evaluation: Evaluation, verdict: Verdict) -> dict[str, Any]:
    return envelope(
        "evaluate",
        inputs=evaluation.inputs,
        settings={"name": evaluation.settings_name, "sha256": evaluation.settings_sha256},
        truth=evaluation.truth.tree() if evaluation.truth else None,
        figures=evaluation.tree(),
        verdict=verdict,
        warnings=evaluation.warnings,
        notes=evaluation.notes,
    )
