"""The true objects at one moment, from a message, and as a camera sees them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Names, Rows
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.ros.vision_numbers import CLASS_OF_NUMBER, IMAGE_PIXELS, LIDAR_POINTS
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes2D, TruthBoxes3D
from lidcam.readers.messages.detections import Detections3D, track_ids
from lidcam.readers.truth.boxes import class_ids_of

STEP_BACK_NS = 2_000_000_000
"""Longest step back of the stamps that truth is asked for: images of a frame lie before and after its stamp."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """True objects at one moment."""

    boxes: TruthBoxes3D  # The objects
    # (N,) int32 by camera, pixels of its image that show each object; `UNKNOWN` where not counted
    camera_pixels: Mapping[str, I32] = field(default_factory=dict)

    @property
    def stamp_ns(self) -> int:
        """The moment."""
        return self.boxes.stamp_ns

    def select(self, rows: Rows) -> "Moment":
        """The given rows (mask or indices), in that order."""
        pixels = {camera: counts[rows] for camera, counts in self.camera_pixels.items()}
        return Moment(self.boxes.select(rows), pixels)


def class_names_of(labels: Names) -> Names:
    """(N,) the labels, numbers of ROS 1 as the names that they stand for."""
    return np.array([CLASS_OF_NUMBER.get(label, label) for label in labels.tolist()], np.str_)


def moment_of(found: Detections3D, class_ids: Mapping[str, int]) -> Moment:
    """The objects of a message; `class_ids` are those of `Config.class_id_of_label`."""
    counts = found.counts
    pixels = f"{IMAGE_PIXELS}/"
    return Moment(
        TruthBoxes3D(
            stamp_ns=found.stamp_ns,
            frame_id=found.frame_id,
            centers=found.centers,
            sizes=found.sizes,
            yaws=found.yaws,
            class_ids=class_ids_of(found.labels.tolist(), class_ids),
            labels=class_names_of(found.labels),
            track_ids=object_ids(found.ids, counts),
            lidar_points=total(counts, LIDAR_POINTS, len(found)),
            image_pixels=total(counts, IMAGE_PIXELS, len(found)),
            is_ignored=np.zeros(len(found), np.bool_),
        ),
        {name.removeprefix(pixels): counted(counts[name]) for name in sorted(counts) if name.startswith(pixels)},
    )


def object_ids(ids: Names, counts: Mapping[str, F64]) -> I64:
    """(N,) int64, ids as numbers, in ROS 1 the count `instance`; `UNKNOWN` where there is neither."""
    found = track_ids(ids)
    if "instance" in counts:
        found = np.where(found == UNKNOWN, counted(counts["instance"]), found).astype(np.int64)
    return found


def counted(values: F64) -> I32:
    """(N,) int32 of counts; `UNKNOWN` where there is none."""
    is_known = np.isfinite(values)
    whole = np.clip(np.where(is_known, values, UNKNOWN), UNKNOWN, np.iinfo(np.int32).max)
    return np.asarray(np.rint(whole), np.int32)


def total(counts: Mapping[str, F64], name: str, n: int) -> I32:
    """(N,) int32, the count of a name, else the sum of its sensors; `UNKNOWN` where there is neither."""
    if name in counts:
        return counted(counts[name])
    of_sensors = [values for key, values in sorted(counts.items()) if key.startswith(f"{name}/")]
    if not of_sensors:
        return np.full(n, UNKNOWN, np.int32)
    stacked = np.array(of_sensors)
    is_known = np.isfinite(stacked)
    return counted(np.where(is_known.any(0), np.where(is_known, stacked, 0.0).sum(0), np.nan))


def projected_truth(boxes: TruthBoxes3D, camera: CameraSensor, pixels: I32 | None) -> TruthBoxes2D:
    """The objects that a camera sees, as boxes around their projections.

    An object without a pixel in the image is hidden, and left out. Where the truth counts the pixels of all images
    together, an object without any is left out, and of the others it is not known which this image shows: those whose
    projection lies in it.
    `pixels` (N,) int32 are those of this image that show each object; `UNKNOWN` or None where they are not counted.
    """
    of_image = np.full(len(boxes), UNKNOWN, np.int32) if pixels is None else pixels
    rows = np.flatnonzero(np.where(of_image == UNKNOWN, boxes.image_pixels, of_image) != 0)
    corners = box_corners(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows])
    xyxy = camera.model.project_boxes(camera.T_camera_site.apply(corners))
    is_seen = np.isfinite(xyxy).all(1)
    seen = rows[is_seen]
    return TruthBoxes2D(
        stamp_ns=boxes.stamp_ns,
        xyxy=xyxy[is_seen],
        class_ids=boxes.class_ids[seen],
        labels=boxes.labels[seen],
        track_ids=boxes.track_ids[seen],
        image_pixels=of_image[seen],
        is_ignored=boxes.is_ignored[seen],
    )
