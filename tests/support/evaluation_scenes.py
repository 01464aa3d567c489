"""Frames of made-up results beside made-up truth, by fixed seeds."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from evaluation_frames import source_boxes, truth_boxes

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
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


def evaluated(frames: Iterable[EvaluationFrame], config: Config, zones: Sequence[Zone] = ()) -> Any:
    """The figures of detection, as a tree of any depth."""
    evaluation = DetectionEvaluation(config, zones)
    for frame in frames:
        evaluation.add_frame(frame)
    return evaluation.figures()


def boxes3d(
    centers: npt.ArrayLike, sizes: npt.ArrayLike, yaws: npt.ArrayLike, scores: npt.ArrayLike, class_ids: npt.ArrayLike
) -> SourceBoxes:
    """What a source found."""
    return source_boxes(
        _rows(centers, sizes, yaws), scores=np.ravel(scores).tolist(), class_ids=np.ravel(class_ids).tolist()
    )


def truth3d(
    centers: npt.ArrayLike, sizes: npt.ArrayLike, yaws: npt.ArrayLike, class_ids: npt.ArrayLike, **columns: Any
) -> TruthBoxes3D:
    """True objects; `columns` are those of `truth_boxes`."""
    labels = [f"label {class_id}" for class_id in np.ravel(class_ids)]
    return truth_boxes(_rows(centers, sizes, yaws), **{"class_ids": np.ravel(class_ids), "labels": labels, **columns})


def _rows(centers: npt.ArrayLike, sizes: npt.ArrayLike, yaws: npt.ArrayLike) -> F64:
    n = np.size(yaws)
    places, extents = np.reshape(centers, (n, 3)), np.reshape(sizes, (n, 3))
    return np.column_stack([places, extents, wrap_angle(np.array(yaws, np.float64).reshape(n))])


def image(
    found_xyxy: npt.ArrayLike, scores: npt.ArrayLike, class_ids: npt.ArrayLike, truth: TruthBoxes2D | None
) -> ImageBoxes:
    """What was found in an image."""
    n = np.size(scores)
    xyxy = np.array(found_xyxy, np.float32).reshape(n, 4)
    found = Boxes2D(
        0, "camera", xyxy, np.array(scores, np.float32).reshape(n), np.array(class_ids, np.int32).reshape(n)
    )
    return ImageBoxes(found, truth)


def truth2d(
    xyxy: npt.ArrayLike,
    class_ids: npt.ArrayLike,
    *,
    image_pixels: npt.ArrayLike | None = None,
    is_ignored: npt.ArrayLike | None = None,
) -> TruthBoxes2D:
    """What an image shows."""
    n = np.size(class_ids)
    return TruthBoxes2D(
        0,
        np.array(xyxy, np.float32).reshape(n, 4),
        np.array(class_ids, np.int32).reshape(n),
        np.array([f"label {class_id}" for class_id in np.ravel(class_ids)], np.str_),
        np.full(n, -1, np.int64),
        np.array(np.full(n, UNKNOWN) if image_pixels is None else image_pixels, np.int32).reshape(n),
        np.array(np.zeros(n) if is_ignored is None else is_ignored, np.bool_).reshape(n),
    )
