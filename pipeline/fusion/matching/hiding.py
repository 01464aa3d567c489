"""Which boxes stand behind others in an image, and what of them is left to see.

Two boxes on the ground that do not overlap can be parted by a line along a side of one of them. The one on the
camera's side of that line is in front: exact for boxes, where a comparison of distances is wrong beside long ones (a
bus along the road, and a pedestrian beside its middle).
"""

import numpy as np

from pipeline.core.arrays import F32, F64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import box_corners
from pipeline.fusion.matching.hiding_kernels import uncovered_parts
from pipeline.fusion.matching.in_view import InView

__all__ = ["hidden_parts"]

MAX_COVERS = 8
"""Of more boxes in front of one, those that cover most of it count."""


def hidden_parts(boxes: Boxes3D, seen: InView, positions_site: F64) -> tuple[F32, F32]:
    """How much of each rectangle is covered by boxes in front of it.

    Args:
        boxes: N boxes in the site frame.
        seen: P of them in images.
        positions_site: (C, 3) where the cameras stand, metres.

    Returns:
        (P,) share of the rectangle that nearer ones cover; (P, 4) the smallest rectangle around the rest, in pixels,
        the rectangle itself where nothing is left.
    """
    return uncovered_parts(
        seen.xyxy,
        seen.cameras,
        seen.rows,
        seen.ranges_m,
        box_corners(boxes.centers, boxes.sizes, boxes.yaws)[:, :4, :2].copy(),
        np.column_stack([boxes.centers[:, :2], np.cos(boxes.yaws), np.sin(boxes.yaws)]),
        boxes.sizes[:, :2] / 2,
        positions_site[:, :2].copy(),
        MAX_COVERS,
    )
