"""Counts of the frames and true objects that are evaluated, and of the others by reason."""

from collections import Counter

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figures
from lidcam.pipeline.evaluation.ignoring import is_evaluated, is_within

_REASONS = ("without_class", "marked_as_ignored", "outside", "unseen")
"""Why a true object is not evaluated; the first one that holds counts."""


class FrameCounts:
    """Counts frames and the true objects in them; an `Evaluator`."""

    def __init__(self, config: Config) -> None:
        self._config = config.evaluate
        self._frames = self._with_truth = 0
        self._objects: Counter[str] = Counter()
        self._labels: Counter[str] = Counter()

    def add(self, frame: EvaluationFrame) -> None:
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
