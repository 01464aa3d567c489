"""What it is worth to take a projected 3D box and a 2D box for one object."""

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.settings.fuse import AssociateConfig

__all__ = ["worth_of_pairs"]


def worth_of_pairs(iou: F64, differs: Bools, config: AssociateConfig) -> F64:
    """The IoU of each pair, less a penalty where the classes differ; 0 where the boxes are no pair.

    Args:
        iou: Overlap of the boxes, of any shape.
        differs: Whether their classes differ, of the same shape.
        config: `min_iou` and `class_penalty`.
    """
    worth = iou - config.class_penalty * differs
    return np.where((iou >= config.min_iou) & (worth > 0), worth, 0.0)
