"""Frames of made-up results beside made-up truth, by fixed seeds."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.rig import Zone
from pipeline.core.settings.config import Config
from pipeline.evaluation.detection.evaluation import DetectionEvaluation
from pipeline.evaluation.records import UNKNOWN, EvaluationFrame, ImageBoxes, SourceBoxes, TruthBoxes2D, TruthBoxes3D


def evaluated(frames: Iterable[EvaluationFrame], config: Config, zones: Sequence[Zone] = ()) -> Any:
    """The figures of detection, as a tree of any depth."""
    evaluation = DetectionEvaluation(config, zones)
    for frame in frames:
        evaluation.add(frame)
    return evaluation.figures()


def boxes3d(
    centers: npt.ArrayLike,
    sizes: npt.ArrayLike,
    yaws: npt.ArrayLike,
    scores: npt.ArrayLike,
    class_ids: npt.ArrayLike,
    stamp_ns: int = 0,
) -> SourceBoxes:
    """What a source found."""
    n = np.size(yaws)
    boxes = Boxes3D(
        stamp_ns,
        "site",
        np.array(centers, np.float64).reshape(n, 3),
        np.array(sizes, np.float64).reshape(n, 3),
        wrap_angle(np.array(yaws, np.float64)),
        np.array(scores, np.float32),
        np.array(class_ids, np.int32),
        np.zeros(n, np.int32),
        np.zeros((n, 3, 3)),
        np.zeros(n, np.uint8),
        np.full(n, stamp_ns, np.int64),
    )
    return SourceBoxes(boxes, np.full(n, -1, np.int64))


def truth3d(
    centers: npt.ArrayLike,
    sizes: npt.ArrayLike,
    yaws: npt.ArrayLike,
    class_ids: npt.ArrayLike,
    *,
    stamp_ns: int = 0,
    labels: npt.ArrayLike | None = None,
    lidar_points: npt.ArrayLike | None = None,
    image_pixels: npt.ArrayLike | None = None,
    is_ignored: npt.ArrayLike | None = None,
) -> TruthBoxes3D:
    """True objects."""
    n = np.size(yaws)
    return TruthBoxes3D(
        stamp_ns,
        "site",
        np.array(centers, np.float64).reshape(n, 3),
        np.array(sizes, np.float64).reshape(n, 3),
        wrap_angle(np.array(yaws, np.float64)),
        np.array(class_ids, np.int32),
        np.array(
            [f"label {class_id}" for class_id in np.asarray(class_ids)] if labels is None else labels, np.str_
        ).reshape(n),
        np.full(n, -1, np.int64),
        np.array(np.full(n, UNKNOWN) if lidar_points is None else lidar_points, np.int32),
        np.array(np.full(n, UNKNOWN) if image_pixels is None else image_pixels, np.int32),
        np.array(np.zeros(n) if is_ignored is None else is_ignored, np.bool_),
    )


def image(
    found_xyxy: npt.ArrayLike,
    scores: npt.ArrayLike,
    class_ids: npt.ArrayLike,
    truth: TruthBoxes2D | None,
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
