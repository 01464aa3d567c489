"""The boxes that an engine proposes, as the boxes of a frame."""

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.overlaps import without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays
from lidcam.pipeline.detectors.protocols import Candidates3D


def likely_boxes(combined: CombinedCloud, site_frame: str, found: Candidates3D, min_scores: F64 | float) -> Boxes3D:
    """Boxes of a cloud in order of falling score, then of x and y; of those in one place only the best.

    Boxes of no class, or with a score below `min_scores`, one number or (K,) of their class, are left out.
    """
    order = np.lexsort((found.centers[:, 1], found.centers[:, 0], -found.scores))
    order = order[found.class_ids[order] >= 0]
    limits = np.asarray(min_scores) if np.ndim(min_scores) == 0 else np.asarray(min_scores)[found.class_ids[order]]
    order = order[found.scores[order] >= limits]
    order = order[without_overlaps(BoxArrays.of(found, order))]
    return found.as_boxes(order, combined.detection_cloud.stamp_ns, site_frame, Source.LIDAR)
