"""The boxes that an engine proposes, as the boxes of a frame."""

import numpy as np

from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.overlaps import without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays
from lidcam.pipeline.detectors.protocols import Candidates3D


def likely_boxes(combined: CombinedCloud, site_frame: str, found: Candidates3D, min_score: float) -> Boxes3D:
    """Boxes in order of falling score, then of x and y; without unlikely ones, and of those in one place the best.

    Args:
        combined: The cloud that they were found in.
        site_frame: Name of its frame.
        found: In any order; those of no class are left out.
        min_score: Boxes with a lower score are left out.
    """
    order = np.lexsort((found.centers[:, 1], found.centers[:, 0], -found.scores))
    order = order[(found.scores[order] >= min_score) & (found.class_ids[order] >= 0)]
    order = order[without_overlaps(BoxArrays(found.centers[order], found.sizes[order], found.yaws[order]))]
    return Boxes3D(
        combined.detection_cloud.stamp_ns,
        site_frame,
        found.centers[order],
        found.sizes[order],
        wrap_angle(found.yaws[order]),
        found.scores[order].astype(np.float32),
        found.class_ids[order].astype(np.int32),
        found.point_counts[order].astype(np.int32),
        found.covariances[order],
        np.full(len(order), Source.LIDAR, np.uint8),
        combined.detection_cloud.stamp_ns + found.time_offsets_ns[order],
    )
