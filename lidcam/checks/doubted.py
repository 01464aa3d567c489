"""Classes of which hardly anything is probable enough, though much of it is likely: people, without cameras.

Where there are 2D boxes, they have the last word: what stays below is mostly walls and hedges.
"""

import numpy as np

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.warning import RunWarning

LIKELY = 0.2
"""Least probability of what is likely there."""

MIN_BOXES, MIN_RATIO = 5, 5
"""A class is told of which so many boxes are likely and not reported, and so many times as many as are reported."""


class DoubtedCheck:
    """Counts by class what is reported, and what is likely and below `fuse.min_score`."""

    def __init__(self, config: Config, *, has_2d_boxes: bool) -> None:
        self._names, self._min_score, self._has_2d_boxes = config.class_names, config.fuse.min_score, has_2d_boxes
        self._doubted, self._reported = np.zeros((2, len(self._names)), np.int64)

    def add(self, frame: FrameResult) -> None:
        """Look at one frame; what a track reports in spite of its probability in this frame is reported."""
        class_ids, count = frame.hypotheses.boxes.class_ids, len(self._names)
        doubted = (frame.beliefs >= LIKELY) & (frame.beliefs < self._min_score)
        doubted[frame.fused.rows[frame.fused.rows >= 0]] = False
        self._doubted += np.bincount(class_ids[doubted], minlength=count)
        self._reported += np.bincount(frame.fused.objects.class_ids, minlength=count)[:count]

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each class that is likely there and hardly reported."""
        if self._has_2d_boxes:
            return ()
        told = (self._doubted >= MIN_BOXES) & (self._doubted >= MIN_RATIO * self._reported)
        return tuple(
            RunWarning(
                self._names[row],
                f"{self._doubted[row]} boxes have a probability of {LIKELY:g} to {self._min_score:g}, below "
                f"fuse.min_score; reported: {self._reported[row]}",
                "2D boxes tell which are right (--model-2d); a smaller fuse.min_score shows all, false ones too",
            )
            for row in np.flatnonzero(told)
        )
