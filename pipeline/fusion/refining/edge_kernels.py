"""The sums of refinement over the edges of boxes before the fit: borders of images, hidden parts, doubtful cameras."""

import math

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["corners_in_cameras", "doubted_edges", "median_shifts", "moved_edges"]

_ROWS, _MASK = "Array(int64, 1, 'C', True)", "Array(boolean, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))


@compiled(f"float64[:, :, ::1]({_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_TABLE}, {_BLOCK}, {_TABLE})")
def corners_in_cameras(
    centers: F64, sizes: F64, cosines: F64, sines: F64, signs: F64, rotations: F64, translations: F64
) -> F64:
    """(P, 8, 3) corners of boxes in the optical frames of their cameras.

    Args:
        centers: (P, 3) in the site frame.
        sizes: (P, 3).
        cosines: (P,) of the yaws.
        sines: (P,) of these.
        signs: (8, 3) `UNIT_CORNERS`.
        rotations: (P, 3, 3) site to camera.
        translations: (P, 3).
    """
    found = np.empty((len(centers), 8, 3))
    for p in range(len(centers)):
        R = rotations[p]
        for k in range(8):
            along, across = signs[k, 0] / 2 * sizes[p, 0], signs[k, 1] / 2 * sizes[p, 1]
            x = along * cosines[p] - across * sines[p] + centers[p, 0]
            y = along * sines[p] + across * cosines[p] + centers[p, 1]
            z = signs[k, 2] / 2 * sizes[p, 2] + centers[p, 2]
            for i in range(3):  # in the order in which einsum adds three products up
                found[p, k, i] = R[i, 0] * x + R[i, 2] * z + R[i, 1] * y + translations[p, i]
    return found


@inlined
def _reached(place: float, ends: tuple[float, float]) -> tuple[float, float]:
    return min(ends[0], place), max(ends[1], place)


@compiled(f"float64[:, ::1]({_BLOCK}, {_TABLE}, Array(int64, 2, 'C', True))")
def moved_edges(pixels: F64, image_sizes: F64, edges: I64) -> F64:
    """(P, 4) see `cut_edges.moved_by_borders`.

    Args:
        pixels: (P, 8, 2) corners of boxes.
        image_sizes: (P, 2).
        edges: (12, 2) the corners at both ends of each edge of a box.
    """
    moved = np.empty((len(pixels), 4))
    for p in range(len(pixels)):
        for axis in range(2):
            limit = image_sizes[p, 1 - axis]
            whole, left = (np.inf, -np.inf), (np.inf, -np.inf)
            for k in range(8):
                along, other = pixels[p, k, axis], pixels[p, k, 1 - axis]
                whole = _reached(along, whole)
                if 0 <= other <= limit:
                    left = _reached(along, left)
            for e in range(len(edges)):
                a, b = pixels[p, edges[e, 0], axis], pixels[p, edges[e, 1], axis]
                c, d = pixels[p, edges[e, 0], 1 - axis], pixels[p, edges[e, 1], 1 - axis]
                for border in (0.0, limit):
                    if min(c, d) < border < max(c, d):
                        left = _reached(a + (b - a) * (border - c) / (d - c), left)
            if left[0] > left[1]:  # nothing is in the image
                left = whole[1], whole[0]
            moved[p, axis], moved[p, axis + 2] = max(left[0] - whole[0], 0.0), max(whole[1] - left[1], 0.0)
    return moved


@compiled(
    "Tuple((float64[:, ::1], boolean[::1], float64[:, ::1], float64[:, ::1]))"
    f"({_TABLE}, {_TABLE}, {_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, {_ROWS}, {_BLOCK}, {_TABLE}, float64)"
)
def doubted_edges(
    xyxy: F64,
    predicted: F64,
    jacobian: F64,
    sigma_px: F64,
    cut_px: F64,
    hidden_px: F64,
    rows: I64,
    covariances: F64,
    image_sizes: F64,
    clearly: float,
) -> tuple[F64, Bools, F64, F64]:
    """Edges of 2D boxes with the noise of borders, and of what hides a part of the object.

    Args:
        xyxy: (P, 4) the 2D boxes.
        predicted: (P, 4) the same edges of the projected boxes.
        jacobian: (P, 4, 3) derivatives of these by x, y and yaw.
        sigma_px: (P, 4) standard deviations.
        cut_px: (P, 4) further ones.
        hidden_px: (P, 4) further ones of edges that are clearly inside of where the box ends.
        rows: (P,) box of each.
        covariances: (N, 7, 7) of the boxes, see `BoxPrior`.
        image_sizes: (P, 2).
        clearly: So many standard deviations.

    Returns:
        (P, 4) standard deviations; (P,) whether all edges are within the image; (P, 2) how far the centre of each 2D
        box lies to the right of that of the projected box, and below; (P, 2) the variances of this.
    """
    count = len(xyxy)
    sigma, whole = np.empty((count, 4)), np.ones(count, np.bool_)
    off, variances = np.empty((count, 2)), np.empty((count, 2))
    slope = np.empty(3)
    for p in range(count):
        C = covariances[rows[p]]
        for e in range(4):
            own, away = math.sqrt(sigma_px[p, e] ** 2 + cut_px[p, e] ** 2), xyxy[p, e] - predicted[p, e]
            by_box = 0.0
            for i in range(3):
                for j in range(3):
                    by_box += jacobian[p, e, i] * C[i, j] * jacobian[p, e, j]
            is_inside = (away if e < 2 else -away) > clearly * math.sqrt(by_box + own**2)
            hidden = hidden_px[p, e] if is_inside else 0.0
            sigma[p, e] = math.sqrt(own**2 + hidden**2)
            whole[p] &= 0 < xyxy[p, e] < image_sizes[p, e % 2]
        for axis in range(2):
            for i in range(3):
                slope[i] = (jacobian[p, axis, i] + jacobian[p, axis + 2, i]) / 2
            variance = 0.0
            for i in range(3):
                for j in range(3):
                    variance += slope[i] * C[i, j] * slope[j]
            variances[p, axis] = variance + (sigma[p, axis] ** 2 + sigma[p, axis + 2] ** 2) / 4
            first, last = xyxy[p, axis] - predicted[p, axis], xyxy[p, axis + 2] - predicted[p, axis + 2]
            off[p, axis] = (first + last) / 2
    return sigma, whole, off, variances


@compiled(f"float64[:, ::1]({_ROWS}, {_TABLE}, {_TABLE}, int64, float64, float64)")
def median_shifts(
    camera_rows: I64, residuals_px: F64, variances_px2: F64, count: int, sure: float, median_spread: float
) -> F64:
    """(C, 2) see `camera_doubt.camera_shifts`.

    Args:
        camera_rows: (P,)
        residuals_px: (P, 2)
        variances_px2: (P, 2)
        count: Of the cameras.
        sure: `SURE`.
        median_spread: `MEDIAN_SPREAD`.
    """
    shifts = np.zeros((count, 2))
    for camera in range(count):
        rows = np.flatnonzero(camera_rows == camera)
        pairs = len(rows)
        if pairs == 0:
            continue
        for axis in range(2):
            ordered, spread = np.sort(residuals_px[rows, axis]), np.sort(variances_px2[rows, axis])
            shift = (ordered[(pairs - 1) // 2] + ordered[pairs // 2]) / 2
            variance = (spread[(pairs - 1) // 2] + spread[pairs // 2]) / 2
            if abs(shift) > sure * (median_spread * math.sqrt(variance / pairs)):
                shifts[camera, axis] = shift
    return shifts
