"""How far the border of an image moves the edges of a 2D box that it does not cut.

The 2D box of a bus that reaches below the image ends on the left where its side leaves the image, not at its rear. So
an edge says nothing of where the box ends if the outermost point of the box lies beyond another border.
"""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import box_corners
from pipeline.fusion.projection import CameraArrays

__all__ = ["moved_by_borders"]


def moved_by_borders(boxes: Boxes3D, cameras: CameraArrays) -> F64:
    """(P, 4) how far left, top, right and bottom of what an image shows are inside of those of the whole box, pixels.

    Of left and right, as far as the upper and the lower border move them, and the other way round. Where nothing of a
    box is in the image, that is all of its extent. Lines between corners are taken for straight.

    Args:
        boxes: P boxes, each wholly in front of its camera.
        cameras: P cameras.
    """
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    seen = np.einsum("pij,pkj->pki", cameras.rotations, corners) + cameras.translations[:, None]
    pixels, _ = cameras.lenses.project(seen)
    moved = np.empty((len(boxes), 4))
    for axis in (0, 1):
        along, other = pixels[..., axis], pixels[..., 1 - axis]
        limit = cameras.image_sizes[:, 1 - axis, None]
        low, high = _extent_between(along, other, limit)
        moved[:, axis], moved[:, axis + 2] = low - along.min(1), along.max(1) - high
    return np.maximum(moved, 0.0)


def _extent_between(along: F64, other: F64, limit: F64) -> tuple[F64, F64]:
    """(P,) least and largest `along` of boxes with corners (P, 8) where `other` is in [0, limit]."""
    first, last = np.array(BOX_EDGES).T
    a, b, c, d = along[:, first], along[:, last], other[:, first], other[:, last]
    rise = np.where(c == d, 1.0, d - c)
    inside = (other >= 0) & (other <= limit)
    places, reached = [along], [inside]
    for border in (0.0, limit):
        crosses = (np.minimum(c, d) < border) & (np.maximum(c, d) > border)
        places.append(np.where(crosses, a + (b - a) * (border - c) / rise, 0.0))
        reached.append(crosses)
    place, is_there = np.concatenate(places, 1), np.concatenate(reached, 1)
    low, high = np.where(is_there, place, np.inf).min(1), np.where(is_there, place, -np.inf).max(1)
    none = ~is_there.any(1)
    return np.where(none, along.max(1), low), np.where(none, along.min(1), high)
