"""The 2D boxes of all cameras of a frame as one table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, I32, I64, select_rows
from pipeline.core.detections import Boxes2D

__all__ = ["FoundBoxes"]


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoxes:
    """M 2D boxes, camera by camera, and in each by falling score, then by class and place: whatever their order was.

    Attributes:
        cameras: (M,) int64 number of the camera.
        rows: (M,) int64, row of `Boxes2D`.
        xyxy: (M, 4) float32 left, top, right, bottom in pixels; may reach beyond the image.
        scores: (M,) float32.
        class_ids: (M,) int32.
        stamps_ns: (M,) int64 time of the image.
    """

    cameras: I64
    rows: I64
    xyxy: F32
    scores: F32
    class_ids: I32
    stamps_ns: I64

    def __len__(self) -> int:
        return len(self.rows)

    @classmethod
    def of(cls, boxes: Mapping[str, Boxes2D], names: Sequence[str]) -> "FoundBoxes":
        """Those of some cameras.

        Args:
            boxes: By camera name.
            names: Of the cameras, by number; those that are not in `boxes` have none.
        """
        numbers = np.array([number for number, name in enumerate(names) if name in boxes], np.int64)
        parts = [boxes[name] for name in names if name in boxes]
        counts = np.array([len(part) for part in parts], np.int64)
        cameras = np.repeat(numbers, counts)
        xyxy = np.concatenate([np.zeros((0, 4), np.float32), *(part.xyxy for part in parts)])
        scores = np.concatenate([np.zeros(0, np.float32), *(part.scores for part in parts)])
        class_ids = np.concatenate([np.zeros(0, np.int32), *(part.class_ids for part in parts)])
        stamps_ns = np.repeat(np.array([part.stamp_ns for part in parts], np.int64), counts)
        rows = np.arange(len(cameras)) - np.repeat(np.cumsum(counts) - counts, counts)
        order = np.lexsort([*xyxy.T, class_ids, -scores, cameras])
        return select_rows(cls(cameras, rows, xyxy, scores, class_ids, stamps_ns), order)
