"""Warns about classes whose objects mostly fall below `fuse.min_score`: people, without cameras.

Runs with 2D boxes are not warned of: with these, boxes below the limit are mostly walls and hedges.
"""

import numpy as np

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.warning import RunWarning

MIN_LIKELY = 0.2
"""Minimum probability of a likely object."""

MIN_BOXES = 5
"""Minimum number of likely but unreported boxes of a class that is named."""

MIN_RATIO = 5
"""Minimum ratio of these to the reported boxes of the class."""


class DoubtedCheck:
    """Counts boxes by class: reported, and likely but below `fuse.min_score`."""

    def __init__(self, config: Config, *, has_2d_boxes: bool) -> None:
        self._names, self._min_score, self._has_2d_boxes = config.class_names, config.fuse.min_score, has_2d_boxes
        self._doubted, self._reported = np.zeros((2, len(self._names)), np.int64)

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame; boxes that a track reports in spite of their probability count as reported."""
        class_ids, count = frame.hypotheses.boxes.class_ids, len(self._names)
        doubted = (frame.beliefs >= MIN_LIKELY) & (frame.beliefs < self._min_score)
        doubted[frame.fused.rows[frame.fused.rows >= 0]] = False
        self._doubted += np.bincount(class_ids[doubted], minlength=count)
        self._reported += np.bincount(frame.fused.objects.class_ids, minlength=count)[:count]

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each class that is likely and hardly reported."""
        if self._has_2d_boxes:
            return ()
        named = (self._doubted >= MIN_BOXES) & (self._doubted >= MIN_RATIO * self._reported)
        return tuple(
            RunWarning(
                self._names[row],
                f"{self._doubted[row]} boxes have a probability of {MIN_LIKELY:g} to {self._min_score:g}, below "
                f"fuse.min_score; reported: {self._reported[row]}",
                "2D boxes tell which are right (--model-2d); a smaller fuse.min_score shows all, false ones too",
            )
            for row in np.flatnonzero(named)
        )
