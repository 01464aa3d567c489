"""The 2D boxes of all cameras of a frame as one table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, I32, I64, Table, select_rows
from lidcam.pipeline.core.detections import Boxes2D


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoxes(Table):
    """M 2D boxes, camera by camera, and in each by falling score, then by class and position."""

    cameras: I64  # (M,) int64 number of the camera
    rows: I64  # (M,) int64, row of `Boxes2D`
    xyxy: F32  # (M, 4) float32 left, top, right, bottom in pixels; may reach beyond the image
    scores: F32  # (M,) float32
    class_ids: I32  # (M,) int32
    stamps_ns: I64  # (M,) int64 time of the image

    @classmethod
    def of(cls, boxes: Mapping[str, Boxes2D], names: Sequence[str]) -> "FoundBoxes":
        """The boxes by camera name as a table, made once for the stages of a frame; `names` gives the numbers."""
        return _table(tuple(boxes.get(name) for name in names))


@lru_cache(maxsize=1)
def _table(boxes: tuple[Boxes2D | None, ...]) -> FoundBoxes:
    numbered = [(number, part) for number, part in enumerate(boxes) if part] or [(0, Boxes2D.empty(0, ""))]
    numbers, parts = zip(*numbered, strict=True)
    counts = [len(part) for part in parts]
    table = FoundBoxes(
        np.repeat(np.array(numbers, np.int64), counts),
        np.concatenate([np.arange(count) for count in counts]),
        np.concatenate([part.xyxy for part in parts]),
        np.concatenate([part.scores for part in parts]),
        np.concatenate([part.class_ids for part in parts]),
        np.repeat(np.array([part.stamp_ns for part in parts], np.int64), counts),
    )
    return select_rows(table, np.lexsort([*table.xyxy.T, table.class_ids, -table.scores, table.cameras]))
