"""The evaluators of a result, and one pass of its frames through all of them."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from lidcam.evaluation.counts import FrameCounts
from lidcam.evaluation.figures import NamedFigures
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import (
    EvaluationFrame,
    Evaluator,
    ImageBoxes,
    SourceBoxes,
    TruthBoxes2D,
    TruthBoxes3D,
)
from lidcam.pipeline.evaluation.mistakes import Mistakes
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation
from lidcam.pipeline.evaluation.unlabelled import UnlabelledEvaluation


def evaluators_of(config: Config, rig: Rig) -> tuple[Evaluator, ...]:
    """The evaluators of a result with these settings and of this rig, in the order of the sections of its figures."""
    return (
        FrameCounts(config),
        DetectionEvaluation(config, rig.counted_zones),
        TrackingEvaluation(config),
        UnlabelledEvaluation(config),
        Mistakes(config),
    )


def measure(frames: Iterable[EvaluationFrame], evaluators: Sequence[Evaluator]) -> dict[str, Any]:
    """The figures of frames, as one tree; the frames come in their order and are read once."""
    waiting = deque(evaluators)
    del evaluators
    for frame in frames:
        for evaluator in waiting:
            evaluator.add(frame)
    figures: dict[str, Any] = {}
    while waiting:  # what one has kept is freed before the next one makes its figures
        figures |= waiting.popleft().figures()
    return figures


def known_figures(config: Config, rig: Rig, sources: Sequence[str]) -> NamedFigures:
    """The figures that a result of these sources will have, by their names: those of a frame without any object.

    Figures named by the words of the truth, and figures of tracks, are not among them.
    """
    none, no_ids = np.zeros(0, np.int32), np.zeros(0, np.int64)
    names, marks = np.zeros(0, np.str_), np.zeros(0, np.bool_)
    truth = TruthBoxes3D(
        0, rig.site_frame, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), none, names, no_ids, none, none, marks
    )
    boxes = Boxes3D.empty(0, rig.site_frame)
    image = ImageBoxes(
        Boxes2D.empty(0, ""), TruthBoxes2D(0, np.zeros((0, 4), np.float32), none, names, no_ids, none, marks)
    )
    found = {source: SourceBoxes(boxes, no_ids) for source in sources}
    frame = EvaluationFrame(0, 0, truth, found, {camera.name: image for camera in rig.cameras}, 0)
    return NamedFigures({**measure([frame], evaluators_of(config, rig)), **timed(0.0)})


def timed(seconds: float) -> dict[str, Any]:
    """The figures that come from the clock."""
    return {"timing": {"evaluation_s": seconds}}
