"""The evaluators of a result, and one pass of its frames through all of them."""

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from typing import Any

from lidcam.evaluation.figures import NamedFigures
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import (
    UNKNOWN,
    EvaluationFrame,
    Evaluator,
    Figures,
    ImageBoxes,
    SourceBoxes,
    TruthBoxes2D,
    TruthBoxes3D,
)
from lidcam.pipeline.evaluation.ignoring import is_evaluated, is_within
from lidcam.pipeline.evaluation.mistakes import Mistakes
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation
from lidcam.pipeline.evaluation.truth_clock import TruthClock
from lidcam.pipeline.evaluation.unlabelled import UnlabelledEvaluation

_REASONS = ("without_class", "marked_as_ignored", "outside", "unseen")
"""Why a true object is not evaluated; the first one that holds counts."""


def evaluators_of(config: Config, rig: Rig) -> tuple[Evaluator, ...]:
    """The evaluators of a result with these settings and of this rig, in the order of the sections of its figures."""
    return (
        FrameCounts(config),
        DetectionEvaluation(config, rig.counted_zones),
        TrackingEvaluation(config),
        UnlabelledEvaluation(config),
        Mistakes(config),
        TruthClock(config),
    )


def measure(frames: Iterable[EvaluationFrame], evaluators: Sequence[Evaluator]) -> dict[str, Any]:
    """The figures of frames, as one tree; the frames come in their order and are read once."""
    waiting = deque(evaluators)
    del evaluators
    for frame in frames:
        for evaluator in waiting:
            evaluator.add_frame(frame)
    figures: dict[str, Any] = {}
    while waiting:  # what one has kept is freed before the next one makes its figures
        figures |= waiting.popleft().figures()
    return figures


def known_figures(config: Config, rig: Rig, sources: Sequence[str]) -> NamedFigures:
    """The figures that a result of these sources will have, by their names: those of a frame without any object.

    Figures named by the words of the truth, and figures of tracks, are not among them.
    """
    truth = TruthBoxes3D.zeros(stamp_ns=0, frame_id=rig.site_frame)
    image = ImageBoxes(Boxes2D.empty(0, ""), TruthBoxes2D.zeros(stamp_ns=0))
    found = {source: SourceBoxes.zeros(boxes=Boxes3D.empty(0, rig.site_frame)) for source in sources}
    frame = EvaluationFrame(0, 0, truth, found, {camera.name: image for camera in rig.cameras}, 0)
    return NamedFigures({**measure([frame], evaluators_of(config, rig)), **timed(0.0)})


def timed(seconds: float) -> dict[str, Any]:
    """The figures that come from the clock."""
    return {"timing": {"evaluation_s": seconds}}


class FrameCounts:
    """Counts frames and the true objects in them; an `Evaluator`."""

    def __init__(self, config: Config) -> None:
        self._config = config.evaluate
        self._frames = self._with_truth = 0
        self._objects: Counter[str] = Counter()
        self._labels: Counter[str] = Counter()

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Count one frame."""
        self._frames += 1
        truth = frame.truth
        if truth is None:
            return
        self._with_truth += 1
        evaluated = is_evaluated(truth, self._config)
        without_class = truth.class_ids == UNKNOWN
        left = ~evaluated
        reasons = without_class, truth.is_ignored, ~is_within(truth.centers, self._config), left
        for name, reason in zip(_REASONS, reasons, strict=True):
            self._objects[name] += int((left & reason).sum())
            left = left & ~reason
        self._objects["evaluated"] += int(evaluated.sum())
        self._labels.update(truth.labels[without_class].tolist())

    def figures(self) -> Figures:
        """`frames`, `frames_with_truth`, and `truth_objects` by reason."""
        return {
            "frames": self._frames,
            "frames_with_truth": self._with_truth,
            "truth_objects": {
                **{name: self._objects[name] for name in ("evaluated", *_REASONS)},
                "labels_without_class": dict(sorted(self._labels.items())),
            },
        }
