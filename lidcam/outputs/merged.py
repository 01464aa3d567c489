"""Two results in one file, with what differs between them drawn."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.evaluation.comparison.comparison import Comparison
from lidcam.pipeline.evaluation.comparison.frames import FramePair
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions
from lidcam.readers.results.result import Result
from lidcam.writers.drawing import STRONG_SCORE
from lidcam.writers.foxglove.layout import foxglove_layout, layout_path
from lidcam.writers.mcap.merged import MergedSide, write_merged
from lidcam.writers.messages.compared import compared_scene, empty_scene
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.viewpoint import SceneSurvey

NAMES = ("a", "b")
"""Prefixes of the topics and the sensors' frames of each result."""

DRAWN = ("fused", "lidar", "cameras")
"""Sources whose differences are drawn: the first of them that is compared."""


def write_both(
    outputs: OutputTransaction,
    path: Path,
    results: tuple[Result, Result],
    comparison: Comparison,
    pairs: Iterator[FramePair],
) -> None:
    """Compare two results, and write them into one file with a layout beside it.

    `path` and its layout are among the locked outputs. The results A and B have one site frame; the comparison takes in
    the pairs of frames.

    Raises:
        OutputError: a file cannot be written.
        RecordingError: a result cannot be read.
    """
    survey = SceneSurvey(results[0].rig)
    with ExitStack() as stack:
        sides = [_side(name, result, stack) for name, result in zip(NAMES, results, strict=True)]
        topics = write_merged(outputs[path], sides, _scenes(comparison, pairs, survey), _metadata(results))
    text = foxglove_layout(results[0].rig, survey, topics, [f"/{name}" for name in NAMES])
    outputs[layout_path(path)].write_text(text)


def _side(name: str, result: Result, stack: ExitStack) -> MergedSide:
    """A result, opened once more: its boxes are read at the same time."""
    recording = stack.enter_context(open_recording([result.path], ReadOptions(limits=result.config.limits)))
    if unreadable := [info for info in recording.topics if info.unreadable and info.message_count]:
        raise RecordingError(f"{result.path}: {unreadable[0].topic} cannot be merged: {unreadable[0].unreadable}")
    channels = [channel for info in recording.topics for channel in info.channels]
    return MergedSide(name, result.rig, channels, recording.messages())


def _metadata(results: tuple[Result, Result]) -> dict[str, str]:
    """The names of the results, and what each says of itself."""
    record = {name: result.path.name for name, result in zip(NAMES, results, strict=True)}
    for name, result in zip(NAMES, results, strict=True):
        record |= {f"{name}.{key}": value for key, value in result.metadata.items()}
    return record


def _scenes(comparison: Comparison, pairs: Iterator[FramePair], survey: SceneSurvey) -> Iterator[tuple[int, Any]]:
    """Log time and drawing of each pair of frames, which are compared on the way; empty where one frame is alone."""
    for pair in pairs:
        compared = comparison.add(pair)
        frames = [frame for frame in (pair.first, pair.second) if frame is not None]
        log_time_ns, stamp_ns = max(frame.log_time_ns for frame in frames), frames[-1].stamp_ns
        drawn = next((compared[name] for name in DRAWN if name in compared), None)
        if drawn is None:
            yield log_time_ns, empty_scene(stamp_ns)
            continue
        for objects in (drawn.first, drawn.second):
            boxes = objects.boxes
            survey.take(boxes, boxes.scores >= STRONG_SCORE, boxes.centers[:, :2])
        scene = compared_scene(drawn.first, drawn.second, drawn.changes, comparison.class_names, stamp_ns=stamp_ns)
        yield log_time_ns, scene
