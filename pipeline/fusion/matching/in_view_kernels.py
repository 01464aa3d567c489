"""The sums of `in_view.py`, compiled."""

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.compiled import compiled

__all__ = ["clipped_edges", "in_pyramids", "seen_from"]

_ROWS, _MASK = "Array(int64, 1, 'C', True)", "Array(boolean, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))


@compiled(f"float64[:, :, ::1]({_TABLE}, {_BLOCK}, {_TABLE})")
def seen_from(points: F64, rotations: F64, translations: F64) -> F64:
    """(C, N, 3) points (N, 3) in the optical frames of C cameras: rotations (C, 3, 3), translations (C, 3)."""
    found = np.empty((len(rotations), len(points), 3))
    for c in range(len(rotations)):
        R = rotations[c]
        for n in range(len(points)):
            x, y, z = points[n]
            for i in range(3):  # in the order in which einsum adds three products up
                found[c, n, i] = R[i, 0] * x + R[i, 2] * z + R[i, 1] * y + translations[c, i]
    return found


@compiled(f"boolean[:, ::1]({_BLOCK}, {_LIST}, {_BLOCK}, {_TABLE}, float64)")
def in_pyramids(centers: F64, radii_m: F64, planes: F64, lengths: F64, near_m: float) -> Bools:
    """(C, N) whether the sphere around each box reaches into what a camera with a straight lens sees.

    Args:
        centers: (C, N, 3) in the optical frames.
        radii_m: (N,) of the spheres.
        planes: (C, 4, 3) through the camera and each border of the image, positive inside.
        lengths: (C, 4) of these.
        near_m: What is not so far ahead is not seen.
    """
    found = np.empty(centers.shape[:2], np.bool_)
    for c in range(centers.shape[0]):
        for n in range(centers.shape[1]):
            x, y, z = centers[c, n]
            found[c, n] = z + radii_m[n] > near_m
            for b in range(4):  # in einsum's order, see above
                depth = planes[c, b, 0] * x + planes[c, b, 2] * z + planes[c, b, 1] * y
                found[c, n] &= depth > -lengths[c, b] * radii_m[n]
    return found


@compiled(f"Tuple((float64[:, ::1], float64[:, :, ::1], int64[::1]))({_TABLE}, {_BLOCK}, {_MASK}, {_ROWS}, {_TABLE})")
def clipped_edges(edges: F64, jacobian: F64, valid: Bools, cameras: I64, image_sizes: F64) -> tuple[F64, F64, I64]:
    """Rectangles clipped to their images.

    Args:
        edges: (P, 4) pixels.
        jacobian: (P, 4, 7) derivatives by `PARAMETERS`.
        valid: (P,) see `ProjectedEdges`.
        cameras: (P,) their cameras.
        image_sizes: (C, 2).

    Returns:
        (P, 4) pixels; (P, 4, 3) derivatives by x, y and yaw, zero where the border of the image is the edge, and where
        a rectangle is not valid; the rows of these.
    """
    xyxy, slopes = np.empty(edges.shape), np.zeros((len(edges), 4, 3))
    for p in range(len(edges)):
        for e in range(4):
            xyxy[p, e] = min(max(edges[p, e], 0.0), image_sizes[cameras[p], e % 2])
            if valid[p] and xyxy[p, e] == edges[p, e]:
                for k in range(3):
                    slopes[p, e, k] = jacobian[p, e, k]
    return xyxy, slopes, np.flatnonzero(~valid)
