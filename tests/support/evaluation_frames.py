"""Frames for tests of evaluation, from plain rows, and their figures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from detections import boxes2d, boxes3d

from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import (
    UNKNOWN,
    EvaluationFrame,
    ImageBoxes,
    SourceBoxes,
    TruthBoxes2D,
    TruthBoxes3D,
)

FRAME_NS = 100_000_000


def rows_at(places: Sequence[tuple[float, float]]) -> list[tuple[float, ...]]:
    """Rows of cars on the ground that look along x."""
    return [(x, y, 0.75, 4.0, 1.7, 1.5, 0.0) for x, y in places]


def truth_boxes(
    rows: npt.ArrayLike,
    tracks: Sequence[int] | None = None,
    *,
    class_ids: npt.ArrayLike | None = None,
    labels: npt.ArrayLike | None = None,
    lidar_points: npt.ArrayLike | None = None,
    image_pixels: Sequence[int] | None = None,
    is_ignored: Sequence[bool] | None = None,
) -> TruthBoxes3D:
    """Truth from rows x, y, z, length, width, height, yaw; class 0, counts not known, not ignored unless given."""
    table = np.array(rows, np.float64).reshape(-1, 7)
    n = len(table)
    return TruthBoxes3D(
        0,
        "site",
        table[:, :3].copy(),
        table[:, 3:6].copy(),
        table[:, 6].copy(),
        np.zeros(n, np.int32) if class_ids is None else np.array(class_ids, np.int32),
        np.array(["any"] * n if labels is None else labels, np.str_),
        np.full(n, UNKNOWN, np.int64) if tracks is None else np.array(tracks, np.int64),
        np.full(n, UNKNOWN, np.int32) if lidar_points is None else np.array(lidar_points, np.int32),
        np.full(n, UNKNOWN, np.int32) if image_pixels is None else np.array(image_pixels, np.int32),
        np.zeros(n, np.bool_) if is_ignored is None else np.array(is_ignored, np.bool_),
    )


def source_boxes(
    rows: npt.ArrayLike,
    tracks: Sequence[int] | None = None,
    *,
    scores: npt.ArrayLike | None = None,
    class_ids: npt.ArrayLike | None = None,
    is_ignored: Sequence[bool] | None = None,
) -> SourceBoxes:
    """Results from rows x, y, z, length, width, height, yaw; score 0.5, class 0 and no tracks unless given."""
    boxes = boxes3d(rows, scores=scores, class_ids=class_ids)
    n = len(boxes)
    track_ids = np.full(n, UNKNOWN, np.int64) if tracks is None else np.array(tracks, np.int64)
    return SourceBoxes(boxes, track_ids, is_ignored=None if is_ignored is None else np.array(is_ignored))


def frame_of(
    index: int,
    truth: TruthBoxes3D | None,
    sources: Mapping[str, SourceBoxes] | None = None,
    images: Mapping[str, ImageBoxes] | None = None,
    *,
    stamp_ns: int | None = None,
    skew_ns: int | None = None,
) -> EvaluationFrame:
    """A frame; ten a second unless a stamp is given."""
    stamp_ns = index * FRAME_NS if stamp_ns is None else stamp_ns
    return EvaluationFrame(index, stamp_ns, truth, sources or {}, images or {}, skew_ns)


def image(
    found_xyxy: npt.ArrayLike, scores: npt.ArrayLike, class_ids: npt.ArrayLike, truth: TruthBoxes2D | None
) -> ImageBoxes:
    """What was found in an image."""
    xyxy = np.array(found_xyxy, np.float64).reshape(-1, 4)
    return ImageBoxes(boxes2d(np.column_stack([xyxy, scores, class_ids])), truth)


def truth2d(
    xyxy: npt.ArrayLike, class_ids: Sequence[int], *, image_pixels: int = UNKNOWN, is_ignored: bool = False
) -> TruthBoxes2D:
    """What an image shows."""
    n = len(class_ids)
    return TruthBoxes2D(
        0,
        np.array(xyxy, np.float32).reshape(n, 4),
        np.array(class_ids, np.int32),
        np.array(["any"] * n, np.str_),
        np.full(n, UNKNOWN, np.int64),
        np.full(n, image_pixels, np.int32),
        np.full(n, is_ignored),
    )


def evaluated(frames: Iterable[EvaluationFrame], config: Config, zones: Sequence[Zone] = ()) -> Any:
    """The figures of detection, as a tree of any depth."""
    evaluation = DetectionEvaluation(config, zones)
    for frame in frames:
        evaluation.add_frame(frame)
    return evaluation.figures()
