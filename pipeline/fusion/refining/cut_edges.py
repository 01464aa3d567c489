"""How far the border of an image moves the edges of a 2D box that it does not cut.

The 2D box of a bus that reaches below the image ends on the left where its side leaves the image, not at its rear. So
an edge says nothing of where the box ends if the outermost point of the box lies beyond another border.
"""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.fusion.projection import CameraArrays
from pipeline.fusion.refining.edge_kernels import corners_in_cameras, moved_edges

__all__ = ["moved_by_borders"]


def moved_by_borders(boxes: Boxes3D, rows: I64, cameras: CameraArrays) -> F64:
    """(P, 4) how far left, top, right and bottom of what an image shows are inside of those of the whole box, pixels.

    Of left and right, as far as the upper and the lower border move them, and the other way round. Where nothing of a
    box is in the image, that is all of its extent. Lines between corners are taken for straight.

    Args:
        boxes: N boxes.
        rows: (P,) the box in the image of each camera, wholly in front of it.
        cameras: P cameras.
    """
    yaws = boxes.yaws[rows]
    placed = boxes.centers.take(rows, 0), boxes.sizes.take(rows, 0), np.cos(yaws), np.sin(yaws)
    pixels, _ = cameras.lenses.project(
        corners_in_cameras(*placed, UNIT_CORNERS, cameras.rotations, cameras.translations)
    )
    return moved_edges(pixels, cameras.image_sizes, BOX_EDGES)
