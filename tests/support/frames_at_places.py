"""Frames of an evaluation with cars at given places."""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.core.detections import Boxes3D
from pipeline.evaluation.records import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D

__all__ = ["evaluation_frame", "source_boxes", "true_boxes"]

STEP_NS = 100_000_000


def true_boxes(
    places: Sequence[tuple[float, float]],
    *,
    stamp_ns: int = 0,
    class_ids: Sequence[int] | None = None,
    labels: Sequence[str] | None = None,
    lidar_points: Sequence[int] | None = None,
    image_pixels: Sequence[int] | None = None,
    is_ignored: Sequence[bool] | None = None,
    size_m: tuple[float, float, float] = (4.0, 1.7, 1.5),
) -> TruthBoxes3D:
    """Objects at x, y; of the first class, seen and evaluated where nothing else is said."""
    n = len(places)
    unknown = [UNKNOWN] * n
    return TruthBoxes3D(
        stamp_ns,
        "site",
        np.array([(x, y, size_m[2] / 2) for x, y in places], np.float64).reshape(n, 3),
        np.tile(np.array(size_m, np.float64), (n, 1)),
        np.zeros(n),
        np.array([0] * n if class_ids is None else class_ids, np.int32),
        np.array(["car"] * n if labels is None else labels, np.str_),
        np.arange(n, dtype=np.int64),
        np.array(unknown if lidar_points is None else lidar_points, np.int32),
        np.array(unknown if image_pixels is None else image_pixels, np.int32),
        np.array([False] * n if is_ignored is None else is_ignored, np.bool_),
    )


def source_boxes(
    places: Sequence[tuple[float, float]],
    *,
    stamp_ns: int = 0,
    class_ids: Sequence[int] | None = None,
    track_ids: Sequence[int] | None = None,
    size_m: tuple[float, float, float] = (4.0, 1.7, 1.5),
) -> SourceBoxes:
    """Boxes at x, y; of the first class and without ids where nothing else is said."""
    n = len(places)
    boxes = Boxes3D(
        stamp_ns,
        "site",
        np.array([(x, y, size_m[2] / 2) for x, y in places], np.float64).reshape(n, 3),
        np.tile(np.array(size_m, np.float64), (n, 1)),
        np.zeros(n),
        np.full(n, 0.9, np.float32),
        np.array([0] * n if class_ids is None else class_ids, np.int32),
        np.zeros(n, np.int32),
        np.zeros((n, 3, 3)),
    )
    return SourceBoxes(boxes, np.array([UNKNOWN] * n if track_ids is None else track_ids, np.int64))


def evaluation_frame(
    index: int, truth: TruthBoxes3D | None = None, sources: Mapping[str, SourceBoxes] | None = None
) -> EvaluationFrame:
    """Frame `index` of a result with ten frames a second."""
    return EvaluationFrame(index, index * STEP_NS, truth, sources or {})
