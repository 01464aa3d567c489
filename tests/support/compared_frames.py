"""Frames of results for comparison, from plain rows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from detections import boxes2d, boxes3d

from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, ResultFrame, SourceBoxes

Row = tuple[float, float, float, float, float, float, float]


def objects(
    *rows: Row,
    class_ids: Sequence[int] | None = None,
    scores: Sequence[float] | None = None,
    ids: Sequence[int] | None = None,
) -> SourceBoxes:
    """Objects of one source from rows x, y, z, length, width, height, yaw."""
    track_ids = [UNKNOWN] * len(rows) if ids is None else ids
    return SourceBoxes(boxes3d(rows, class_ids=class_ids, scores=scores), np.array(track_ids, np.int64))


def run_of(
    count: int, found: SourceBoxes, *, camera: Boxes2D | None = None, step_ns: int = 100_000_000
) -> list[ResultFrame]:
    """Frames in which nothing moves, from 1 s on."""
    cameras = {"cam": boxes2d([(10, 10, 50, 40, 0.9, 0)]) if camera is None else camera}
    frame = ResultFrame(0, 10**9, 10**9, {"fused": found}, cameras)
    return [replace(frame, index=index, stamp_ns=10**9 + index * step_ns) for index in range(count)]
