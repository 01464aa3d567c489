"""An evaluation: open a result, find the truth, measure all frames in one pass. Nothing is printed here."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

from lidcam.evaluation.doubts import doubts
from lidcam.evaluation.evaluation import Evaluation, EvaluationJob, Truth
from lidcam.evaluation.evaluators import evaluators_of, known_figures, measure, timed
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.evaluation.requirement import check_names
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Evaluator
from lidcam.pipeline.evaluation.labelled_part import LabelledPartSearch
from lidcam.readers.input_file import InputFile, read_input_file, read_opened_files
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.rig.search import zones_of
from lidcam.readers.truth.open import OpenTruth, open_truth
from lidcam.run.effect import settings_sha256
from lidcam.run.missing import changed_lines, damage_lines

Advance = Callable[[float, str], None]
Progress = Callable[[float], AbstractContextManager[Advance]]
"""Shows the share of the recorded seconds that is done, as `lidcam.cli.printing.progress.show_progress` does."""


def not_shown(_: float) -> AbstractContextManager[Advance]:
    """Shows nothing."""
    return nullcontext(lambda *_: None)


def evaluate_result(job: EvaluationJob, show: Progress = not_shown, others: Sequence[Evaluator] = ()) -> Evaluation:
    """Evaluate a result of lidcam; `others` are further evaluators that see the frames.

    Raises:
        RequirementError: a requirement names a figure that there cannot be; nothing is measured.
        LidcamError: the result, the truth or the settings are at fault.
    """
    started = time.perf_counter()
    job = within_labels(job)
    with _opened(job) as (result, found), show((result.recording.end_ns - result.recording.start_ns) / 1e9) as advance:
        config, frames = result.config, EvaluationFrames(result, found)
        tree = measure(_watched(frames, advance), (*evaluators_of(config, result.rig), *others))
        if not tree["frames"]:
            raise RecordingError(f"{job.result}: expected a result with frames, found none")
        figures = NamedFigures({**tree, **timed(time.perf_counter() - started)})
        inputs = read_opened_files(result.recording.opened)
        truth = Truth(found.source.description, _files(job, result, found), job.labelled) if found.source else None
        changed = {file.path for file in (*inputs, *(truth.inputs if truth else ())) if file.is_changed}
        return Evaluation(
            figures=figures,
            inputs=inputs,
            settings_name=result.metadata.get("settings", ""),
            settings_sha256=settings_sha256(config),
            truth=truth,
            outcomes=tuple(requirement.check(figures) for requirement in job.requirements),
            warnings=doubts(tree, has_truth=truth is not None, lidars_detect=config.detect3d.method != "none"),
            notes=tuple(note for note in frames.notes if not (truth and note == f"truth: {truth.source}")),
            incomplete=(*damage_lines(result.recording.losses), *changed_lines(sorted(changed))),
        )


def within_labels(job: EvaluationJob) -> EvaluationJob:
    """The job; limited to what one camera sees, if truth is labelled there alone and `evaluate.region` is not set.

    Reads frames up to the first true object that no camera sees. Raises as `evaluate_result`.
    """
    with _opened(job) as (result, found):
        settings = result.config.evaluate
        if settings.region is not None or found.source is None:
            return job
        result.sources, result.cameras = ("lidar",), ()  # nothing else is looked at
        search = LabelledPartSearch(result.rig.cameras)
        part = search.found() if all(map(search.add_frame, EvaluationFrames(result, found))) else None
    if part is None:
        return job
    range_m = min(part.max_range_m, settings.max_range_m or part.max_range_m)
    limits = f"evaluate.region={json.dumps(part.region)}", f"evaluate.max_range_m={range_m}"
    words = f"in the view of {part.camera}, up to {range_m:g} m"
    return replace(job, settings=(*job.settings, *limits), labelled=words)


@contextmanager
def _opened(job: EvaluationJob) -> Iterator[tuple[Result, OpenTruth]]:
    """The result, with what the job's rig file has of zones and vehicles, and the truth; checks the requirements."""
    with open_result(job.result, job.settings) as result:
        if job.rig is not None:
            zones = result.rig.zones if job.rig.zones is None else zones_of(job.rig, result.config)
            result.rig = replace(result.rig, truth=job.rig.vehicles or result.rig.truth, zones=zones)
        if job.requirements:
            seen = replace(result.rig, cameras=tuple(one for one in result.rig.cameras if one.name in result.cameras))
            check_names(job.requirements, known_figures(result.config, seen, result.sources))
        with open_truth(result, job.truth, topic=job.truth_topic) as found:
            yield result, found


def _files(job: EvaluationJob, result: Result, found: OpenTruth) -> tuple[InputFile, ...]:
    """The files that the truth stands in, when they were read; a folder of labels may be large: its name alone."""
    recording = found.poses[0] if job.truth else result.recording
    if not job.truth or recording.paths != result.recording.paths:  # labels are no recording
        return read_opened_files(recording.opened)
    folders = {path for path in job.truth if isinstance(path, Path) and path.is_dir()}
    return tuple(InputFile.unread(path) if path in folders else read_input_file(path) for path in job.truth)


def _watched(frames: Iterable[EvaluationFrame], advance: Advance) -> Iterator[EvaluationFrame]:
    """The frames; reports each one when it was measured."""
    start_ns: int | None = None
    for frame in frames:
        start_ns = frame.stamp_ns if start_ns is None else start_ns
        yield frame
        advance((frame.stamp_ns - start_ns) / 1e9, f"{frame.index + 1} frames evaluated")
