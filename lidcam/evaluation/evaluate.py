"""An evaluation: open a result, find the truth, measure all frames in one pass. Nothing is printed here."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path

from lidcam.evaluation.doubts import doubts
from lidcam.evaluation.evaluation import Evaluation, EvaluationJob, Truth
from lidcam.evaluation.evaluators import evaluators_of, known_figures, measure, timed
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.evaluation.requirement import check_names
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Evaluator
from lidcam.readers.input_file import InputFile, read_input_file, read_opened_files
from lidcam.readers.location import Location
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.rig.schema import RigFile
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
    with open_result(job.result, job.settings) as result, ExitStack() as stack:
        if job.rig is not None:
            result.rig = _with_rig(result, job.rig)
        config = result.config
        advance = stack.enter_context(show((result.recording.end_ns - result.recording.start_ns) / 1e9))
        seen = replace(result.rig, cameras=tuple(one for one in result.rig.cameras if one.name in result.cameras))
        check_names(job.requirements, known_figures(config, seen, result.sources))
        found, files = _find_truth(job, result, stack)
        frames = EvaluationFrames(result, found)
        tree = measure(_watched(frames, advance), (*evaluators_of(config, seen), *others))
        if not tree["frames"]:
            raise RecordingError(f"{job.result}: expected a result with frames, found none")
        figures = NamedFigures({**tree, **timed(time.perf_counter() - started)})
        inputs = read_opened_files(result.recording.opened)
        truth = Truth((found.source.description,), files()) if found.source else None
        changed = {file.path for file in (*inputs, *(truth.inputs if truth else ())) if file.is_changed}
        return Evaluation(
            figures=figures,
            inputs=inputs,
            settings_name=result.metadata.get("settings", ""),
            settings_sha256=settings_sha256(config),
            truth=truth,
            outcomes=tuple(requirement.check(figures) for requirement in job.requirements),
            warnings=doubts(tree, has_truth=truth is not None, lidars_detect=config.detect3d.method != "none"),
            notes=tuple(note for note in frames.notes if not (truth and note == f"truth: {truth.sources[0]}")),
            incomplete=(*damage_lines(result.recording.losses), *changed_lines(sorted(changed))),
        )


def _with_rig(result: Result, rig_file: RigFile) -> Rig:
    """The rig of a result with the zones and the vehicles of a rig file, where that has some."""
    rig = result.rig
    zones = rig.zones if rig_file.zones is None else zones_of(rig_file, result.config)
    return replace(rig, truth=rig_file.vehicles or rig.truth, zones=zones)


def _find_truth(
    job: EvaluationJob, result: Result, stack: ExitStack
) -> tuple[OpenTruth, Callable[[], tuple[InputFile, ...]]]:
    """The truth, open until `stack` ends, and what gives the files that it stands in, when they were read."""
    found = stack.enter_context(open_truth(result, job.truth, topic=job.truth_topic))
    recording = found.poses[0] if job.truth else result.recording
    if job.truth and recording.paths == result.recording.paths:  # labels are no recording
        return found, lambda: tuple(map(_identity, job.truth))
    return found, lambda: read_opened_files(recording.opened)


def _identity(path: Location) -> InputFile:
    """Size and checksum of a file; a folder of labels has its name alone, because it may hold thousands of clouds."""
    return InputFile.unread(path) if isinstance(path, Path) and path.is_dir() else read_input_file(path)


def _watched(frames: Iterable[EvaluationFrame], advance: Advance) -> Iterator[EvaluationFrame]:
    """The frames; reports each one when it was measured."""
    start_ns: int | None = None
    for frame in frames:
        start_ns = frame.stamp_ns if start_ns is None else start_ns
        yield frame
        advance((frame.stamp_ns - start_ns) / 1e9, f"{frame.index + 1} frames evaluated")
