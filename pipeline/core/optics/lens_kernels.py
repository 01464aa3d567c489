"""The lens models, compiled: points, their derivatives, and the outermost points of objects in images.

The formulas are those of `core.camera`. For a point at (x, y) = (X / Z, Y / Z) with r2 = x x + y y, a lens of
`rational_polynomial` (of which `plumb_bob` and lenses without distortion are cases) shows it at

    x scale(r2) + 2 p1 x y + p2 (r2 + 2 x x),   y scale(r2) + p1 (r2 + 2 y y) + 2 p2 x y

and an `equidistant` one at (x, y) scale(r2), where the scale turns the tangent of the angle to the axis into a
polynomial of the angle. Derivatives follow from that of the scale by r2.
"""

import math

import numpy as np

from pipeline.core.arrays import F64, Bools, Indices
from pipeline.core.compiled import compiled, inlined

__all__ = ["outermost_points", "pixels_of_points", "slopes_of_points"]

_NEAR_M = 0.005
"""Half of `core.camera.NEAR_M`: what is not so far ahead has no place in the image."""

_ON_AXIS = 1e-4
"""Below this radius the quotients of the equidistant model lose their digits: the series about the axis stands in."""

_BOOLS = "Array(boolean, 1, 'C', True)"
_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))
_LENSES = f"{_BLOCK}, {_TABLE}, {_BOOLS}, {_LIST}"


@inlined
def _within(r2: float, equidistant: bool, limit: float) -> bool:
    """Whether a point is where the lens model is one-to-one."""
    return math.atan(math.sqrt(r2)) < limit if equidistant else r2 < limit * limit


@inlined
def _radial(r2: float, k: F64, equidistant: bool) -> tuple[float, float]:
    """The radial scale at a squared radius, and its derivative by it."""
    if equidistant:
        radius = math.sqrt(r2)
        theta = math.atan(radius)
        t2 = theta * theta
        if radius < _ON_AXIS:
            scale, slope = 1 + (k[0] - 1 / 3) * r2, k[0] - 1 / 3
        else:
            scale = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / radius
            growth = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
            slope = (growth / (1 + r2) - scale) / (2 * radius * radius)
    else:
        top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        bottom = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        scale = top / bottom
        top_slope = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])
        bottom_slope = k[5] + r2 * (2 * k[6] + 3 * r2 * k[7])
        slope = (top_slope - scale * bottom_slope) / bottom
    return scale, slope


@inlined
def _pixel(x: float, y: float, z: float, K: F64, k: F64, equidistant: bool, limit: float) -> tuple[float, float, bool]:
    """The pixel u, v of a point in the optical frame, and whether it is ahead and within the lens model."""
    ahead = z > _NEAR_M
    depth = z if ahead else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    inside = _within(r2, equidistant, limit)
    r2 = r2 if inside else 0.0
    scale, _ = _radial(r2, k, equidistant)
    p1, p2 = (0.0, 0.0) if equidistant else (k[2], k[3])
    x_lens = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_lens = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    u = K[0, 0] * x_lens + K[0, 1] * y_lens + K[0, 2] + 0.5
    v = K[1, 1] * y_lens + K[1, 2] + 0.5
    return u, v, ahead and inside


@inlined
def _slopes(
    x: float, y: float, z: float, K: F64, k: F64, equidistant: bool, limit: float
) -> tuple[float, float, float, float, float, float]:
    """Derivatives of u by x, y, z, and then those of v."""
    depth = z if z > _NEAR_M else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    r2 = r2 if _within(r2, equidistant, limit) else 0.0
    scale, slope = _radial(r2, k, equidistant)
    p1, p2 = (0.0, 0.0) if equidistant else (k[2], k[3])
    xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # x by y, and y by x
    yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    u_by_x, u_by_y = (K[0, 0] * xx + K[0, 1] * xy) / depth, (K[0, 0] * xy + K[0, 1] * yy) / depth
    v_by_x, v_by_y = K[1, 1] * xy / depth, K[1, 1] * yy / depth
    return u_by_x, u_by_y, -u_by_x * x - u_by_y * y, v_by_x, v_by_y, -v_by_x * x - v_by_y * y


@inlined
def _in_camera(a: float, b: float, c: float, axes: F64) -> tuple[float, float, float]:
    """A point of an object in the optical frame, from that along the axes of its box."""
    x = a * axes[0, 0] + b * axes[1, 0] + c * axes[2, 0] + axes[3, 0]
    y = a * axes[0, 1] + b * axes[1, 1] + c * axes[2, 1] + axes[3, 1]
    z = a * axes[0, 2] + b * axes[1, 2] + c * axes[2, 2] + axes[3, 2]
    return x, y, z


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({_BLOCK}, {_LENSES})")
def pixels_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """(P, S, 2) pixels of points (P, S, 3), and (P, S) whether they are valid; as `Lenses.project`.

    Args:
        points: Metres in the optical frames.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).
    """
    pixels, valid = np.empty((*points.shape[:2], 2)), np.empty(points.shape[:2], np.bool_)
    for p in range(points.shape[0]):
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            u, v, is_valid = _pixel(x, y, z, K[p], coefficients[p], equidistant[p], limits[p])
            pixels[p, s, 0], pixels[p, s, 1], valid[p, s] = u, v, is_valid
    return pixels, valid


@compiled(f"float64[:, :, :, ::1]({_BLOCK}, {_LENSES})")
def slopes_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> F64:
    """(P, S, 2, 3) derivatives of the pixels of points; arguments as those of `pixels_of_points`."""
    slopes = np.empty((*points.shape[:2], 2, 3))
    for p in range(points.shape[0]):
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            found = _slopes(x, y, z, K[p], coefficients[p], equidistant[p], limits[p])
            for k in range(3):
                slopes[p, s, 0, k], slopes[p, s, 1, k] = found[k], found[3 + k]
    return slopes


@compiled(
    "Tuple((float64[:, ::1], float64[:, :, ::1], int64[:, ::1], boolean[::1]))"
    f"({_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_ROWS}, {_TABLE}, {_BLOCK}, {_BLOCK}, {_TABLE}, {_LENSES})"
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
    u, v, ahead = np.empty(len(signs)), np.empty(len(signs)), np.empty(len(signs), np.bool_)
    half, axes = np.empty(3), np.empty((4, 3))  # the last: length, width, height and centre in the optical frame
    for q in range(len(rows)):
        p, cos, sin = rows[q], cosines[q], sines[q]
        R, lens, k = rotations[p], K[p], coefficients[p]
        o = p if len(offsets) > 1 else 0
        for i in range(3):
            half[i] = sizes[q, i] / 2
            axes[0, i] = R[i, 0] * cos + R[i, 1] * sin
            axes[1, i] = R[i, 1] * cos - R[i, 0] * sin
            axes[2, i] = R[i, 2]
            at = R[i, 0] * centers[q, 0] + R[i, 1] * centers[q, 1] + R[i, 2] * centers[q, 2]
            axes[3, i] = at + translations[p, i]

        for s in range(len(signs)):
            a = signs[s, 0] * half[0] + offsets[o, s, 0]
            b = signs[s, 1] * half[1] + offsets[o, s, 1]
            c = signs[s, 2] * half[2] + offsets[o, s, 2]
            x, y, z = _in_camera(a, b, c, axes)
            u[s], v[s], ahead[s] = _pixel(x, y, z, lens, k, equidistant[p], limits[p])
        leftmost, topmost, rightmost, bottommost = 0, 0, 0, 0
        for s in range(len(signs)):
            valid[q] &= ahead[s]
            leftmost = s if u[s] < u[leftmost] else leftmost
            topmost = s if v[s] < v[topmost] else topmost
            rightmost = s if u[s] > u[rightmost] else rightmost
            bottommost = s if v[s] > v[bottommost] else bottommost
        makers[q, 0], makers[q, 1], makers[q, 2], makers[q, 3] = leftmost, topmost, rightmost, bottommost

        for e in range(4):
            s = makers[q, e]
            edges[q, e] = u[s] if e % 2 == 0 else v[s]
            a = signs[s, 0] * half[0] + offsets[o, s, 0]
            b = signs[s, 1] * half[1] + offsets[o, s, 1]
            c = signs[s, 2] * half[2] + offsets[o, s, 2]
            x, y, z = _in_camera(a, b, c, axes)
            by_point = _slopes(x, y, z, lens, k, equidistant[p], limits[p])
            by_x, by_y, by_z = by_point[:3] if e % 2 == 0 else by_point[3:]
            by_length = by_x * axes[0, 0] + by_y * axes[0, 1] + by_z * axes[0, 2]  # per metre along the box's own axes
            by_width = by_x * axes[1, 0] + by_y * axes[1, 1] + by_z * axes[1, 2]
            by_height = by_x * axes[2, 0] + by_y * axes[2, 1] + by_z * axes[2, 2]
            slopes[q, e, 0] = by_length * cos - by_width * sin
            slopes[q, e, 1] = by_length * sin + by_width * cos
            slopes[q, e, 2] = by_width * a - by_length * b
            slopes[q, e, 3] = by_length * signs[s, 0] / 2
            slopes[q, e, 4] = by_width * signs[s, 1] / 2
            slopes[q, e, 5] = by_height * signs[s, 2] / 2
            slopes[q, e, 6] = by_height
    return edges, slopes, makers, valid
