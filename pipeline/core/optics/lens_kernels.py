"""The lens models, compiled: points, their derivatives, rays, and the outermost points of objects in images.

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

__all__ = ["outermost_points", "pixels_of_points", "rays_of_pixels", "rectangles_of_cut_boxes", "slopes_of_points"]

_NEAR_M = 0.005
"""Half of `core.camera.NEAR_M`: what is not so far ahead has no place in the image."""

_CUT_M = 0.01
"""`core.camera.NEAR_M`: what is nearer is cut away."""

_ON_AXIS = 1e-4
"""Below this radius the quotients of the equidistant model lose their digits: the series about the axis stands in."""

Axis = tuple[float, float, float]

_BOOLS = "Array(boolean, 1, 'C', True)"
_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))
_LENSES = f"{_BLOCK}, {_TABLE}, {_BOOLS}, {_LIST}"


@inlined
def _within(r2: float, equidistant: bool, limit: float) -> bool:
    """Whether a point is where the lens model is one-to-one."""
    return math.atan(math.sqrt(r2)) < limit if equidistant else r2 < limit * limit


@inlined
def _lens(K: F64, k: F64, equidistant: bool) -> tuple[float, ...]:
    """Focal lengths, centre and skew of a camera, its tangential and its radial coefficients: quicker than arrays."""
    p1, p2 = (0.0, 0.0) if equidistant else (k[2], k[3])
    third, fourth = (k[2], k[3]) if equidistant else (k[4], 0.0)
    return K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1], p1, p2, k[0], k[1], third, fourth, k[5], k[6], k[7]


@inlined
def _scale(r2: float, lens: tuple[float, ...], equidistant: bool) -> float:
    """The radial scale at a squared radius."""
    k1, k2, k3, k4, k5, k6, k7 = lens[7:]
    if equidistant:
        radius = math.sqrt(r2)
        theta = math.atan(radius)
        t2 = theta * theta
        grown = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return grown / radius if radius >= _ON_AXIS else 1 + (k1 - 1 / 3) * r2
    return (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)))


@inlined
def _scale_slope(r2: float, scale: float, lens: tuple[float, ...], equidistant: bool) -> float:
    """The derivative of the radial scale by the squared radius."""
    k1, k2, k3, k4, k5, k6, k7 = lens[7:]
    if equidistant:
        theta = math.atan(math.sqrt(r2))
        t2 = theta * theta
        growth = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        return (growth / (1 + r2) - scale) / (2 * r2) if math.sqrt(r2) >= _ON_AXIS else k1 - 1 / 3
    top_slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    bottom_slope = k5 + r2 * (2 * k6 + 3 * r2 * k7)
    return (top_slope - scale * bottom_slope) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)))


@inlined
def _pixel(
    x: float, y: float, z: float, lens: tuple[float, ...], equidistant: bool, limit: float
) -> tuple[float, float, bool]:
    """The pixel u, v of a point in the optical frame, and whether it is ahead and within the lens model."""
    fx, fy, cx, cy, skew, p1, p2 = lens[:7]
    ahead = z > _NEAR_M
    depth = z if ahead else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    inside = _within(r2, equidistant, limit)
    r2 = r2 if inside else 0.0
    scale = _scale(r2, lens, equidistant)
    x_lens = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_lens = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return fx * x_lens + skew * y_lens + cx + 0.5, fy * y_lens + cy + 0.5, ahead and inside


@inlined
def _slopes(
    x: float, y: float, z: float, lens: tuple[float, ...], equidistant: bool, limit: float
) -> tuple[float, float, float, float, float, float]:
    """Derivatives of u by x, y, z, and then those of v."""
    fx, fy, _, _, skew, p1, p2 = lens[:7]
    depth = z if z > _NEAR_M else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    r2 = r2 if _within(r2, equidistant, limit) else 0.0
    scale = _scale(r2, lens, equidistant)
    slope = _scale_slope(r2, scale, lens, equidistant)
    xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # x by y, and y by x
    yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    u_by_x, u_by_y = (fx * xx + skew * xy) / depth, (fx * xy + skew * yy) / depth
    v_by_x, v_by_y = fy * xy / depth, fy * yy / depth
    return u_by_x, u_by_y, -u_by_x * x - u_by_y * y, v_by_x, v_by_y, -v_by_x * x - v_by_y * y


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
        u[s], v[s], valid[s] = _pixel(x, y, z, lens, equidistant, limit)


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
        lens = _lens(K[p], coefficients[p], equidistant[p])
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            u, v, is_valid = _pixel(x, y, z, lens, equidistant[p], limits[p])
            pixels[p, s, 0], pixels[p, s, 1], valid[p, s] = u, v, is_valid
    return pixels, valid


@compiled(f"float64[:, :, :, ::1]({_BLOCK}, {_LENSES})")
def slopes_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> F64:
    """(P, S, 2, 3) derivatives of the pixels of points; arguments as those of `pixels_of_points`."""
    slopes = np.empty((*points.shape[:2], 2, 3))
    for p in range(points.shape[0]):
        lens = _lens(K[p], coefficients[p], equidistant[p])
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            found = _slopes(x, y, z, lens, equidistant[p], limits[p])
            for k in range(3):
                slopes[p, s, 0, k], slopes[p, s, 1, k] = found[k], found[3 + k]
    return slopes


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({_BLOCK}, {_LENSES}, int64, float64)")
def rays_of_pixels(
    pixels: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64, max_steps: int, near_px: float
) -> tuple[F64, Bools]:
    """Rays that are projected to given pixels, by Newton's method from the ray of a lens without distortion.

    Args:
        pixels: (P, S, 2) of each camera.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).
        max_steps: So many rays are tried for a pixel.
        near_px: A ray is found when it is projected this near to its pixel, across and down.

    Returns:
        (P, S, 3) directions in the optical frames, of depth 1; and (P, S) whether there is such a ray. Where there is
        none, the direction is the optical axis.
    """
    rays, found = np.zeros((*pixels.shape[:2], 3)), np.zeros(pixels.shape[:2], np.bool_)
    for p in range(pixels.shape[0]):
        lens = _lens(K[p], coefficients[p], equidistant[p])
        fx, fy, cx, cy, skew = lens[:5]
        for s in range(pixels.shape[1]):
            y = (pixels[p, s, 1] - 0.5 - cy) / fy
            x = (pixels[p, s, 0] - 0.5 - cx - skew * y) / fx
            for _ in range(max_steps):
                u, v, valid = _pixel(x, y, 1.0, lens, equidistant[p], limits[p])
                right, down = pixels[p, s, 0] - u, pixels[p, s, 1] - v
                found[p, s] = valid and abs(right) <= near_px and abs(down) <= near_px
                if found[p, s] or not valid:
                    break
                a, b, _, c, d, _ = _slopes(x, y, 1.0, lens, equidistant[p], limits[p])
                determinant = a * d - b * c
                whole = np.inf if determinant == 0 else determinant
                x += (d * right - b * down) / whole
                y += (a * down - c * right) / whole
            rays[p, s, 2] = 1.0
            if found[p, s]:
                rays[p, s, 0], rays[p, s, 1] = x, y
    return rays, found


@inlined
def _cut(start: F64, end: F64) -> Axis:
    """Where a line begins, seen from its start: there, or where it comes out of what is cut away."""
    if start[2] >= _CUT_M:
        return start[0], start[1], start[2]
    rise = 1.0 if start[2] == end[2] else end[2] - start[2]
    way = min(max((_CUT_M - start[2]) / rise, 0.0), 1.0)
    return (
        start[0] + way * (end[0] - start[0]),
        start[1] + way * (end[1] - start[1]),
        start[2] + way * (end[2] - start[2]),
    )


@compiled(f"float64[:, ::1]({_BLOCK}, Array(int64, 2, 'C', True), {_LIST}, {_TABLE}, {_LENSES})")
def rectangles_of_cut_boxes(
    corners: F64,
    edges: Indices,
    shares: F64,
    image_sizes: F64,
    K: F64,
    coefficients: F64,
    equidistant: Bools,
    limits: F64,
) -> F64:
    """(P, 4) rectangles around boxes as `CameraModel.project_boxes`; NaN where nothing of a box is in the image.

    Args:
        corners: (P, 8, 3) metres in the optical frames.
        edges: (12, 2) corners at both ends of each edge.
        shares: (S,) places along an edge, from 0 to 1, where a bent lens may show its outermost point.
        image_sizes: (P, 2).
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).
    """
    found = np.full((len(corners), 4), np.nan)
    for p in range(len(corners)):
        lens = _lens(K[p], coefficients[p], equidistant[p])
        low_u, low_v, high_u, high_v, is_whole = np.inf, np.inf, -np.inf, -np.inf, True
        for k in range(8):
            is_whole = is_whole and corners[p, k, 2] >= _CUT_M
        if is_whole and not equidistant[p] and not coefficients[p].any():  # then the corners are outermost
            for k in range(8):
                x, y, z = corners[p, k, 0], corners[p, k, 1], corners[p, k, 2]
                u, v, _ = _pixel(x, y, z, lens, False, limits[p])
                low_u, low_v, high_u, high_v = min(low_u, u), min(low_v, v), max(high_u, u), max(high_v, v)
        else:
            for e in range(len(edges)):
                first, last = corners[p, edges[e, 0]], corners[p, edges[e, 1]]
                if max(first[2], last[2]) < _CUT_M:
                    continue
                start, end = _cut(first, last), _cut(last, first)
                for share in shares:
                    x = start[0] * (1 - share) + end[0] * share
                    y = start[1] * (1 - share) + end[1] * share
                    z = start[2] * (1 - share) + end[2] * share
                    u, v, is_valid = _pixel(x, y, z, lens, equidistant[p], limits[p])
                    if is_valid:
                        low_u, low_v, high_u, high_v = min(low_u, u), min(low_v, v), max(high_u, u), max(high_v, v)
        width, height = image_sizes[p, 0], image_sizes[p, 1]
        left, right = min(max(low_u, 0.0), width), min(max(high_u, 0.0), width)
        top, bottom = min(max(low_v, 0.0), height), min(max(high_v, 0.0), height)
        if right > left and bottom > top:
            found[p, 0], found[p, 1], found[p, 2], found[p, 3] = left, top, right, bottom
    return found


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
    count = len(signs)
    points, u, v, ahead = np.empty((3, count)), np.empty(count), np.empty(count), np.empty(count, np.bool_)
    for q in range(len(rows)):
        p, cos, sin = rows[q], cosines[q], sines[q]
        R, is_equidistant, limit = rotations[p], equidistant[p], limits[p]
        lens = _lens(K[p], coefficients[p], is_equidistant)
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
            by_point = _slopes(x, y, z, lens, is_equidistant, limit)
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
