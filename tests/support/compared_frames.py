"""Frames of results for comparison, from plain rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from detections import boxes2d, boxes3d

from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, SourceBoxes

Row = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A `ComparedFrame`."""

    index: int
    stamp_ns: int
    sources: Mapping[str, SourceBoxes] = field(default_factory=dict)
    cameras: Mapping[str, Boxes2D] = field(default_factory=dict)

    @property
    def log_time_ns(self) -> int:
        return self.stamp_ns + 7


def objects(
    *rows: Row,
    class_ids: Sequence[int] | None = None,
    scores: Sequence[float] | None = None,
    ids: Sequence[int] | None = None,
) -> SourceBoxes:
    """Objects of one source from rows x, y, z, length, width, height, yaw."""
    track_ids = [UNKNOWN] * len(rows) if ids is None else ids
    return SourceBoxes(boxes3d(rows, class_ids=class_ids, scores=scores), np.array(track_ids, np.int64))


def run_of(count: int, found: SourceBoxes, *, camera: Boxes2D | None = None, step_ns: int = 100_000_000) -> list[Frame]:
    """Frames in which nothing moves, from 1 s on."""
    cameras = {"cam": boxes2d([(10, 10, 50, 40, 0.9, 0)]) if camera is None else camera}
    frame = Frame(0, 10**9, {"fused": found}, cameras)
    return [replace(frame, index=index, stamp_ns=10**9 + index * step_ns) for index in range(count)]
