"""The outermost points of objects in images; compiled."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, Indices
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.core.optics.lenses import BLOCK, LENSES, LIST, TABLE, lens_of, pixel_of, slopes_of

Axis = tuple[float, float, float]


@inlined
def _moved(R: F64, t: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point, rotated and then moved."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@inlined
def _in_camera(
    a: float, b: float, c: float, along: Axis, across: Axis, up: Axis, origin: Axis
) -> tuple[float, float, float]:
    """A point at a, b, c along the axes of a box about its centre, in the optical frame."""
    x = a * along[0] + b * across[0] + c * up[0] + origin[0]
    y = a * along[1] + b * across[1] + c * up[1] + origin[1]
    z = a * along[2] + b * across[2] + c * up[2] + origin[2]
    return x, y, z


@inlined
def _show(
    points: F64,
    along: Axis,
    across: Axis,
    up: Axis,
    origin: Axis,
    lens: tuple[float, ...],
    equidistant: bool,
    limit: float,
    u: F64,
    v: F64,
    valid: Bools,
) -> None:
    """The pixels of points (3, S) along the axes of a box, into `u`, `v` and `valid`."""
    for s in range(points.shape[1]):
        x, y, z = _in_camera(points[0, s], points[1, s], points[2, s], along, across, up, origin)
        u[s], v[s], valid[s] = pixel_of(x, y, z, lens, equidistant, limit)


@compiled(
    "Tuple((float64[:, ::1], float64[:, :, ::1], int64[:, ::1], boolean[::1]))"
    f"({TABLE}, {TABLE}, {LIST}, {LIST}, Array(int64, 1, 'C', True), {TABLE}, {BLOCK}, {BLOCK}, {TABLE}, {LENSES})"
)
def outermost_points(
    centers: F64,
    sizes: F64,
    cosines: F64,
    sines: F64,
    rows: Indices,
    signs: F64,
    offsets: F64,
    rotations: F64,
    translations: F64,
    K: F64,
    coefficients: F64,
    equidistant: Bools,
    limits: F64,
) -> tuple[F64, F64, Indices, Bools]:
    """The leftmost, topmost, rightmost and bottommost point of each object in the image of its camera.

    Points of an object are at `signs * size / 2 + offsets` along the axes of its box.

    Args:
        centers: (Q, 3) centres of boxes in the site frame, metres.
        sizes: (Q, 3) length, width, height, metres.
        cosines: (Q,) of the yaws.
        sines: (Q,) of the yaws.
        rows: (Q,) camera and outline of each box, of P of both.
        signs: (S, 3), the same for all.
        offsets: (P, S, 3) metres, or (1, S, 3) if they are the same for all.
        rotations: (P, 3, 3) site to camera.
        translations: (P, 3) metres.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).

    Returns:
        (Q, 4) u, v, u, v of these points, pixels; (Q, 4, 7) their derivatives by x, y, yaw, length, width, height, z of
        the box; (Q, 4) which of the S points they are, of those alike the first; (Q,) whether all points of the object
        are ahead and within the lens model.
    """
    edges, slopes = np.empty((len(rows), 4)), np.empty((len(rows), 4, 7))
    makers, valid = np.zeros((len(rows), 4), np.int64), np.ones(len(rows), np.bool_)
    count = len(signs)
    points, u, v, ahead = np.empty((3, count)), np.empty(count), np.empty(count), np.empty(count, np.bool_)
    for q in range(len(rows)):
        p, cos, sin = rows[q], cosines[q], sines[q]
        R, is_equidistant, limit = rotations[p], equidistant[p], limits[p]
        lens = lens_of(K[p], coefficients[p], is_equidistant)
        # The directions of length, width and height, and the centre, in the optical frame.
        along = R[0, 0] * cos + R[0, 1] * sin, R[1, 0] * cos + R[1, 1] * sin, R[2, 0] * cos + R[2, 1] * sin
        across = R[0, 1] * cos - R[0, 0] * sin, R[1, 1] * cos - R[1, 0] * sin, R[2, 1] * cos - R[2, 0] * sin
        up = R[0, 2], R[1, 2], R[2, 2]
        origin = _moved(R, translations[p], centers[q, 0], centers[q, 1], centers[q, 2])
        for s in range(count):
            for i in range(3):
                points[i, s] = signs[s, i] * (sizes[q, i] / 2) + offsets[p if len(offsets) > 1 else 0, s, i]

        if is_equidistant:
            _show(points, along, across, up, origin, lens, True, limit, u, v, ahead)
        else:  # by itself: without an arctangent, several points at once
            _show(points, along, across, up, origin, lens, False, limit, u, v, ahead)
        left, top, right, bottom = 0, 0, 0, 0
        for s in range(count):
            valid[q] &= ahead[s]
            left = s if u[s] < u[left] else left
            top = s if v[s] < v[top] else top
            right = s if u[s] > u[right] else right
            bottom = s if v[s] > v[bottom] else bottom
        makers[q, 0], makers[q, 1], makers[q, 2], makers[q, 3] = left, top, right, bottom

        for e in range(4):
            s = makers[q, e]
            a, b, c = points[0, s], points[1, s], points[2, s]
            x, y, z = _in_camera(a, b, c, along, across, up, origin)
            by_point = slopes_of(x, y, z, lens, is_equidistant, limit)
            edges[q, e], (by_x, by_y, by_z) = (u[s], by_point[:3]) if e % 2 == 0 else (v[s], by_point[3:])
            by_length = by_x * along[0] + by_y * along[1] + by_z * along[2]  # per metre along the box's own axes
            by_width = by_x * across[0] + by_y * across[1] + by_z * across[2]
            by_height = by_x * up[0] + by_y * up[1] + by_z * up[2]
            slopes[q, e, 0] = by_length * cos - by_width * sin
            slopes[q, e, 1] = by_length * sin + by_width * cos
            slopes[q, e, 2] = by_width * a - by_length * b
            slopes[q, e, 3] = by_length * signs[s, 0] / 2
            slopes[q, e, 4] = by_width * signs[s, 1] / 2
            slopes[q, e, 5] = by_height * signs[s, 2] / 2
            slopes[q, e, 6] = by_height
    return edges, slopes, makers, valid
