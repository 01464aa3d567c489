"""Warnings about boxes: classes mostly below `fuse.min_score`, and numbers that no class has."""

import re
from collections.abc import Iterator, Mapping

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

    def __init__(self, config: Config, *, has_2d_boxes: bool, has_images: bool = True) -> None:
        self._names, self._min_score, self._has_2d_boxes = config.class_names, config.fuse.min_score, has_2d_boxes
        self._has_images = has_images
        self._doubted, self._reported = np.zeros((2, len(self._names)), np.int64)

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame; boxes that a track reports in spite of their probability count as reported."""
        class_ids, count = frame.hypotheses.boxes.class_ids, len(self._names)
        doubted = (frame.beliefs >= MIN_LIKELY) & (frame.beliefs < self._min_score)
        doubted[frame.fused.rows[frame.fused.rows >= 0]] = False
        self._doubted += np.bincount(class_ids[doubted], minlength=count)
        self._reported += np.bincount(frame.fused.objects.class_ids, minlength=count)[:count]

    @property
    def warnings(self) -> Iterator[RunWarning]:
        """One that names the classes that are likely and hardly reported, if there are any."""
        named = np.flatnonzero((self._doubted >= MIN_BOXES) & (self._doubted >= MIN_RATIO * self._reported))
        if len(named) and not self._has_2d_boxes:
            counts = ", ".join(f"{self._doubted[row]} {self._names[row]}" for row in named)
            yield RunWarning(
                "fuse.min_score",
                f"{counts} boxes score {MIN_LIKELY:g} to {self._min_score:g}, below it",
                "a 2D network (lidcam fetch, --model-2d FILE.onnx) tells which are right"
                if self._has_images
                else f"--set fuse.min_score={0.3 if self._min_score > 0.3 else MIN_LIKELY:g} reports more of them",
            )


MAX_LISTED = 10
"""Maximum number of class numbers that are named."""


def class_number_warnings(
    unused_boxes: Mapping[str, int], unused_boxes3d: Mapping[str, int], config: Config
) -> Iterator[RunWarning]:
    """A warning if boxes have numbers that no class has; the other numbers may then be misread, too.

    Recorded boxes that were not used are counted by reason.
    """
    coco, autoware = "COCO does (0 person, 2 car)", "Autoware does (1 car, 7 pedestrian)"
    if config.detect2d.class_numbers == "labels":
        remedy = f"{coco}, --set detect2d.class_numbers=coco"
        yield from _warnings("recorded 2D boxes", unused_boxes, remedy, config)
    if config.detect3d.recorded.class_numbers == "labels":
        remedy = f"{autoware} or as {coco}, --set detect3d.recorded.class_numbers=autoware or =coco"
        yield from _warnings("recorded 3D boxes", unused_boxes3d, remedy, config)


def _warnings(subject: str, unused_boxes: Mapping[str, int], remedy: str, config: Config) -> Iterator[RunWarning]:
    numbers = {
        int(found[1]): count
        for reason, count in unused_boxes.items()
        if (found := re.fullmatch(r"class '(\d+)' is not configured", reason))
    }
    if not numbers:
        return
    listed = ", ".join(map(str, sorted(numbers)[:MAX_LISTED])) + (", ..." if len(numbers) > MAX_LISTED else "")
    known = ", ".join(
        f"{label} {prior.name}" for prior in config.classes for label in prior.labels if label.isdecimal()
    )
    yield RunWarning(
        subject,
        f"{sum(numbers.values())} have unknown class numbers ({listed}); known are {known or 'none'}",
        f"if their detector numbers as {remedy}; or add these numbers to the labels of the classes",
    )
