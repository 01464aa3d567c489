"""Which objects stand behind others, as far as points tell: a coarse depth image of each camera.

A camera sees nothing behind a point of the cloud. The points of all lidars are sorted into cells of each camera's field
of view, and each cell keeps the range of its nearest point (a depth buffer: Catmull, A subdivision algorithm for
computer display of curved surfaces, 1974). An object is hidden as far as the cells that it fills have a point that is
nearer than the object's near side. Cells without a point say nothing.

What hides what does not depend on the lens: cells are of equal size in the plane one metre ahead of a camera, without
distortion. The ground is left out: a cell at the foot of an object also holds the ground in front of it, which hides
nothing.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pipeline.core.arrays import F32, F64, Indices
from pipeline.core.camera import CameraModel
from pipeline.core.rig import CameraSensor
from pipeline.fusion.belief.occlusion_kernels import nearer_shares, nearest_in_cells

__all__ = ["hidden_by_points"]


MAX_POINTS = 3000
"""Points that are looked at in a frame, evenly chosen from all: what hides an object is large."""

COLUMNS, ROWS = 32, 24
"""Cells of a field of view."""

WIDER = 1.2
"""The cells reach so far beyond what a lens without distortion would show: most distortions show more."""

WIDEST = 4.0
"""Tangent of the largest angle to the axis that has cells; beyond, nothing is known to be hidden."""

NEARER_SHARE = 0.97
"""Points hide an object if they are nearer than this share of the range of its near side."""

OPEN_CELLS = 1.0
"""Cells that are taken to be free beside those that are measured, so that a single point hides nothing wholly."""

NEAR_M = 0.01
"""What is not so far ahead of a camera is not in its image."""


def hidden_by_points(
    views: Sequence[CameraSensor], xyz_site: F32, corners_site: F64, cameras: Indices, objects: Indices
) -> F64:
    """(Q,) share of an object that nearer points cover in the view of a camera, in [0, 1), of Q pairs of both.

    Args:
        views: C cameras as they stood when their images were taken.
        xyz_site: (P, 3) points in the site frame, metres.
        corners_site: (N, 8, 3) corners of the objects' boxes in the site frame, metres.
        cameras: (Q,) camera of each pair.
        objects: (Q,) object of each pair.
    """
    if not len(cameras):
        return np.zeros(0)
    is_used = np.zeros(len(views), np.bool_)
    is_used[cameras] = True
    low, cell = (values[is_used] for values in _cells(tuple(view.model for view in views)))
    matrices = np.array([view.T_camera_site.matrix for view in views])[is_used]
    matrices32, low32, cell32 = (values.astype(np.float32) for values in (matrices, low, cell))
    nearest = nearest_in_cells(matrices32, _sampled(xyz_site), low32, cell32, COLUMNS, ROWS, NEAR_M)
    pairs = (np.cumsum(is_used) - 1)[cameras], np.ascontiguousarray(objects)
    return nearer_shares(nearest, matrices, corners_site, *pairs, low, cell, NEAR_M, NEARER_SHARE, OPEN_CELLS)


def _sampled(xyz: F32) -> F32:
    return xyz[:: -(-len(xyz) // MAX_POINTS) or 1]


@lru_cache(maxsize=4)
def _cells(models: tuple[CameraModel, ...]) -> tuple[F64, F64]:
    """(C, 2) low end of the field of view across and down, and (C, 2) size of a cell, in the plane one metre ahead."""
    focal = np.array([(model.K[0, 0], model.K[1, 1]) for model in models])
    middle = np.array([(model.K[0, 2], model.K[1, 2]) for model in models])
    size = np.array([(model.width_px, model.height_px) for model in models], np.float64)
    low = np.maximum(-WIDER * middle / focal, -WIDEST)
    high = np.minimum(WIDER * (size - middle) / focal, WIDEST)
    return low, (high - low) / (COLUMNS, ROWS)
