"""An evaluation: open a result, find the truth, measure all frames in one pass. Nothing is printed here."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from lidcam.evaluation.evaluation import Evaluation, EvaluationJob, Truth
from lidcam.evaluation.evaluators import evaluators_of, known_figures, measure, timed
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.evaluation.requirement import check_names
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.text import listed
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Evaluator
from lidcam.pipeline.evaluation.labelled_part import LabelledPartSearch
from lidcam.readers.input_file import InputFile, read_input_file, read_opened_files
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.rig.search import zones_of
from lidcam.readers.truth.open import OpenTruth, open_truth
from lidcam.run.effect import settings_sha256
from lidcam.run.missing import changed_lines, damage_lines
from lidcam.run.warning import RunWarning

ALL = "all"
"""Name of the figures of all classes."""

MIN_COVERED = 0.5
"""Smallest share of the frames that truth should cover."""

MAX_LABELS = 5
"""Largest number of labels without a class that a warning lists."""


def doubts(tree: Mapping[str, Any], *, has_truth: bool, lidars_detect: bool = True) -> tuple[RunWarning, ...]:
    """Warnings, with remedies, about a tree of figures that are doubtful or empty; none without truth.

    `lidars_detect`: the run was to detect with the lidars.
    """
    if not has_truth:
        return ()
    return (
        *_times(tree),
        *_objects(tree["truth_objects"]),
        *_places(tree, lidars_detect=lidars_detect),
        *_taken_away(tree),
    )


def _times(tree: Mapping[str, Any]) -> Iterator[RunWarning]:
    frames, covered = tree["frames"], tree["frames_with_truth"]
    if frames and covered < MIN_COVERED * frames:
        yield RunWarning(
            "truth",
            f"it covers the time of {covered or 'none'} of {frames} frames",
            "check that it is of the same recording, and that its stamps are of the same clock"
            if not covered
            else "only frames with truth count",
        )
    if offset_s := tree.get("truth_offset_s"):
        side = "later" if offset_s > 0 else "earlier"
        yield RunWarning(
            "truth",
            f"most objects that move are found where it has them about {abs(offset_s):.2f} s {side}",
            f"if its clock is another one: --set evaluate.truth_offset_ms={1000 * offset_s:.0f}",
        )


def _objects(counts: Mapping[str, Any]) -> Iterator[RunWarning]:
    reasons = {
        "without_class": "of no configured class",
        "marked_as_ignored": "marked as ignored",
        "outside": "outside of evaluate.region or evaluate.max_range_m",
        "unseen": "without a lidar point and without a pixel",
    }
    found = [f"{counts[name]} {words}" for name, words in reasons.items() if counts[name]]
    if found and not counts["evaluated"]:
        yield RunWarning(
            "truth",
            f"none of its objects is evaluated: {', '.join(found)}",
            "look at the section evaluate of the settings",
        )
    labels = sorted(counts["labels_without_class"].items(), key=lambda item: (-item[1], item[0]))
    if labels:
        names = listed([f"{label} ({count})" for label, count in labels], MAX_LABELS)
        yield RunWarning(
            "truth",
            f"objects of no configured class are ignored: {names}",
            "add the words to classes.N.labels if they mean one of the classes",
        )


def _places(tree: Mapping[str, Any], *, lidars_detect: bool) -> Iterator[RunWarning]:
    for source, classes in tree.get("sources", {}).items():
        figures = classes[ALL]
        if source == "lidar" and not lidars_detect:
            yield RunWarning(
                source,
                "the run was made with detect3d.method=none, so that the lidars detect nothing",
                "process it again with another method to compare the lidars with the truth",
            )
        elif figures["truth"] and not figures["found"]:
            yield RunWarning(source, "nothing was found in any frame with truth", "look at the warnings of the run")
        elif figures["truth"] and not figures["right"]:
            yield RunWarning(
                source,
                f"none of {figures['found']} boxes lies where one of {figures['truth']} true objects of its class does",
                "check that truth and result are of the same recording and in the same frame of reference",
            )


def _taken_away(tree: Mapping[str, Any]) -> Iterator[RunWarning]:
    """Classes for which fusion is worse than a single sensor, beyond chance."""
    for name, gains in tree["fusion_gain"].items() if "cameras" in tree["sources"] else ():
        gain = next(one for figure, one in gains.items() if figure.startswith("ap_bev"))
        if gain["takes_away"]:
            yield RunWarning(
                "fused",
                f"{name}: fusion takes away {-gain['value']:.2f} AP ({gain['low']:+.2f} to {gain['high']:+.2f}) from "
                f"{gain['over']} alone",
                "look at the calibration and the 2D boxes of the cameras, and at the settings fuse",
            )


Advance = Callable[[float, str], None]
Progress = Callable[[float], AbstractContextManager[Advance]]
"""Shows the share of the recorded seconds that is done, as `lidcam.cli.printing.progress.show_progress` does."""


def not_shown(_: float) -> AbstractContextManager[Advance]:
    """Shows nothing."""
    return nullcontext(lambda *_: None)


def evaluate_result(job: EvaluationJob, show: Progress = not_shown, others: Sequence[Evaluator] = ()) -> Evaluation:
    """Evaluate a result of lidcam; `others` are further evaluators that see the frames.

    Raises RequirementError, before anything is measured, if a requirement names a figure that there cannot be, and
    LidcamError if the result, the truth or the settings are at fault.
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
