"""Which labelled objects a sensor or the fusion found, and its false boxes."""

from dataclasses import dataclass

import numpy as np
from labelled_frames import Label, LabelledFrame

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.evaluation.assignment import assign_nearest

CLASSES = {"Car": "car", "Pedestrian": "pedestrian", "Cyclist": "bicycle"}
"""Labelled classes that are counted, and the classes of the settings that they are."""

RANGE_M, GATE_M = 40.0, 2.0


@dataclass(frozen=True, slots=True)
class Count:
    """One class in one frame."""

    labels: int  # objects to find
    found: tuple[tuple[float, float], ...]  # distance of the centres on the ground (m), difference of the axes (deg)
    false: int  # boxes that are no object of this class


def count_frame(
    frame: LabelledFrame, boxes: Boxes3D, class_names: tuple[str, ...], T_site_lidar: Transform
) -> dict[str, Count]:
    """Counts of each class, by its label.

    A box finds a label of its class within `GATE_M` on the ground, one the other. Boxes on objects that are not to be
    found (further away, of another vehicle's class), in parts of the image that nobody labelled, outside the image or
    beyond `RANGE_M` are neither found nor false.
    """
    T_lidar_site = T_site_lidar.inverse()
    centers = T_lidar_site.apply(boxes.centers)
    yaws = boxes.yaws + np.arctan2(T_lidar_site.matrix[1, 0], T_lidar_site.matrix[0, 0])
    is_excused = excused(frame, centers) | (np.hypot(centers[:, 0], centers[:, 1]) > RANGE_M)
    names = np.array(class_names, object)[boxes.class_ids]
    counts = {}
    for label, name in CLASSES.items():
        of_class = names == name
        labels = [one for one in frame.labels if one.label == label and _range_m(one) <= RANGE_M]
        counts[label] = _count(labels, centers[of_class], yaws[of_class], is_excused[of_class])
    return counts


def _count(labels: list[Label], centers: F64, yaws: F64, excused: Bools) -> Count:
    places = np.array([one.T_lidar_box[:2, 3] for one in labels]).reshape(-1, 2)
    distances = np.linalg.norm(places[:, None] - centers[None, :, :2], axis=2)
    first, second = np.nonzero(distances <= GATE_M)
    chosen = assign_nearest(first, second, distances[first, second])
    first, second = first[chosen], second[chosen]
    turns = yaws[second] - np.array([labels[row].yaw for row in first])
    turns_deg = np.degrees(np.abs(wrap_angle(2 * turns)) / 2)
    is_false = ~excused
    is_false[second] = False
    found = tuple(zip(distances[first, second].tolist(), turns_deg.tolist(), strict=True))
    return Count(len(labels), found, int(is_false.sum()))


def _range_m(label: Label) -> float:
    return float(np.hypot(*label.T_lidar_box[:2, 3]))


def excused(frame: LabelledFrame, centers: F64) -> Bools:
    """Whether a box is outside the image, where nobody labelled, or on an object that is not to be found."""
    pixels, valid = frame.camera.project(frame.T_camera_lidar.apply(centers))
    inside = (pixels >= 0) & (pixels < [frame.camera.width_px, frame.camera.height_px])
    is_excused = np.asarray(~(valid & inside.all(1)))
    for left, top, right, bottom in frame.unlabelled_xyxy:
        is_excused |= ((pixels >= [left, top]) & (pixels <= [right, bottom])).all(1)
    for label in frame.labels:
        if label.label in CLASSES and _range_m(label) <= RANGE_M:
            continue
        local = (centers - label.T_lidar_box[:3, 3]) @ label.T_lidar_box[:3, :3]
        reach = np.array(label.size_m[:2]) / 2 + GATE_M
        is_excused |= (np.abs(local[:, :2]) <= reach).all(1)
    return is_excused
