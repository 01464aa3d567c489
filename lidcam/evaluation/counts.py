"""How many frames and true objects are evaluated, and why others are not."""

from collections import Counter

from pipeline.core.settings.config import Config
from pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figures, TruthBoxes3D
from pipeline.evaluation.ignoring import is_evaluated, is_within

__all__ = ["FrameCounts"]


class FrameCounts:
    """Counts frames, and the true objects in them by what becomes of them; an `Evaluator`."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._frames = self._with_truth = 0
        self._objects: Counter[str] = Counter()
        self._labels: Counter[str] = Counter()

    def add(self, frame: EvaluationFrame) -> None:
        """Count one frame."""
        self._frames += 1
        if frame.truth is not None:
            self._with_truth += 1
            self._count(frame.truth)

    def figures(self) -> Figures:
        """`frames`, `frames_with_truth`, and `truth_objects` by what becomes of them, the first reason that holds."""
        return {
            "frames": self._frames,
            "frames_with_truth": self._with_truth,
            "truth_objects": {
                **{name: self._objects[name] for name in ("evaluated", *_REASONS)},
                "labels_without_class": dict(sorted(self._labels.items())),
            },
        }

    def _count(self, truth: TruthBoxes3D) -> None:
        config = self._config.evaluate
        evaluated, within = is_evaluated(truth, config), is_within(truth.centers, config)
        without_class = truth.class_ids == UNKNOWN
        left = ~evaluated
        for name, reason in (
            ("without_class", without_class),
            ("marked_as_ignored", truth.is_ignored),
            ("outside", ~within),
            ("unseen", left),
        ):
            self._objects[name] += int((left & reason).sum())
            left = left & ~reason
        self._objects["evaluated"] += int(evaluated.sum())
        self._labels.update(truth.labels[without_class].tolist())


_REASONS = ("without_class", "marked_as_ignored", "outside", "unseen")
