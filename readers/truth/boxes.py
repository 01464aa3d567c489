"""Labelled objects as arrays of truth."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32
from lidcam.pipeline.core.ros.vision_numbers import CLASS_OF_NUMBER
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """One object in 3D: see `TruthBoxes3D`."""

    label: str
    T_frame_box: F64  # (4, 4) pose of the centre of its box
    size_m: tuple[float, float, float]  # Length, width, height
    track_id: int = UNKNOWN
    is_ignored: bool = False


def truth_boxes_3d(
    stamp_ns: int, frame_id: str, objects: Sequence[Labelled], class_ids: Mapping[str, int]
) -> TruthBoxes3D:
    """Objects at one moment; `class_ids` are those of `Config.class_id_of_label`."""
    return TruthBoxes3D(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        centers=np.array([one.T_frame_box[:3, 3] for one in objects], np.float64).reshape(-1, 3),
        sizes=np.array([one.size_m for one in objects], np.float64).reshape(-1, 3),
        yaws=np.array([yaw_of(one.T_frame_box) for one in objects], np.float64),
        class_ids=class_ids_of([one.label for one in objects], class_ids),
        labels=np.array([one.label for one in objects], np.str_),
        track_ids=np.array([one.track_id for one in objects], np.int64),
        lidar_points=np.full(len(objects), UNKNOWN, np.int32),
        image_pixels=np.full(len(objects), UNKNOWN, np.int32),
        is_ignored=np.array([one.is_ignored for one in objects], np.bool_),
    )


def yaw_of(pose: F64) -> float:
    """Heading of the x axis of a pose (4, 4) about +z, in (-pi, pi]; of a tilted one, of its projection."""
    yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
    return yaw if yaw > -np.pi else float(np.pi)


def class_ids_of(labels: Iterable[str], class_ids: Mapping[str, int]) -> I32:
    """(N,) int32, rows of the configured classes, by name or number of ROS 1; `UNKNOWN` for a label of none."""
    names = [label.strip().lower() for label in labels]
    found = [class_ids.get(name, class_ids.get(CLASS_OF_NUMBER.get(name, ""), UNKNOWN)) for name in names]
    return np.array(found, np.int32)
