"""The sums of `placing.py`: everything between the functions whose last bit differs between machines."""

import math

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled
from pipeline.core.geometry.bilinear import between

__all__ = ["bearings_between_sides", "corners_seen", "laid_out", "least_squares", "places_at", "rises"]

MATRIX = "float64[:, ::1]"
CUBE = "float64[:, :, ::1]"
BLOCKS = "float64[:, :, :, ::1]"
_FIXED_LIST, _FIXED_MATRIX = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@compiled(f"Tuple(({CUBE}, {CUBE}, {MATRIX}))({MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, {MATRIX})")
def corners_seen(cos: F64, sin: F64, sizes_m: F64, forward: F64, left: F64) -> tuple[F64, F64, F64]:
    """The corners of objects, and how far the nearest is from the centre: see `placing._Shape`.

    Args:
        cos: (P, H) of the angle from the ray to the centre to each heading.
        sin: (P, H)
        sizes_m: (P, 3) length, width, height.
        forward: (1, 4) of the corners along the length, in halves of it.
        left: (1, 4) along the width.

    Returns:
        (P, H, 4) from the centre away from the camera, and to the left; and (P, H).
    """
    along, aside = np.empty((*cos.shape, 4)), np.empty((*cos.shape, 4))
    depth = np.empty(cos.shape)
    for p in range(cos.shape[0]):
        length, width = sizes_m[p, 0], sizes_m[p, 1]
        for h in range(cos.shape[1]):
            for k in range(4):
                ahead, beside = length / 2 * forward[0, k], width / 2 * left[0, k]
                along[p, h, k] = ahead * cos[p, h] - beside * sin[p, h]
                aside[p, h, k] = ahead * sin[p, h] + beside * cos[p, h]
            depth[p, h] = (length * abs(cos[p, h]) + width * abs(sin[p, h])) / 2
    return along, aside, depth


@compiled(
    f"Tuple(({MATRIX}, {MATRIX}, {CUBE}, {BLOCKS}))"
    f"({MATRIX}, {MATRIX}, {MATRIX}, {CUBE}, {MATRIX}, {_FIXED_MATRIX}, float64, float64)"
)
def places_at(
    range_m: F64,
    first_m: F64,
    depth_m: F64,
    along_m: F64,
    towards: F64,
    origin: F64,
    contact_share: float,
    nearest_share: float,
) -> tuple[F64, F64, F64, F64]:
    """Where objects, their corners and their contacts with the ground are, at given ranges.

    Args:
        range_m: (P, H) of the centre.
        first_m: (P, H) by the height of the box alone.
        depth_m: (P, H) see `placing._Shape`.
        along_m: (P, H, 4) see there.
        towards: (P, 2) unit vectors from the camera to the object, seen from above.
        origin: (P, 3) the camera.
        contact_share: `CONTACT_SHARE`.
        nearest_share: `NEAREST_SHARE`.

    Returns:
        (P, H) range of the contact; (P, H) first range over this one; (P, H, 4) of the corners from the camera, along
        the ray to the centre; (2, P, H, 2) x and y of the contact and of the centre.
    """
    contact_m, back, away_m = np.empty(range_m.shape), np.empty(range_m.shape), np.empty(along_m.shape)
    places = np.empty((2, *range_m.shape, 2))
    for p in range(range_m.shape[0]):
        for h in range(range_m.shape[1]):
            distance, nearest = range_m[p, h], nearest_share * range_m[p, h]
            contact_m[p, h] = max(distance - contact_share * depth_m[p, h], nearest)
            back[p, h] = first_m[p, h] / distance
            for k in range(4):
                away_m[p, h, k] = max(distance + along_m[p, h, k], nearest)
            for axis in range(2):
                places[0, p, h, axis] = origin[p, axis] + contact_m[p, h] * towards[p, axis]
                places[1, p, h, axis] = origin[p, axis] + distance * towards[p, axis]
    return contact_m, back, away_m, places


@compiled(f"{CUBE}({BLOCKS}, {CUBE}, {_FIXED_MATRIX}, {_FIXED_LIST}, {_FIXED_MATRIX}, {_FIXED_LIST})")
def rises(places: F64, sloped: F64, origin: F64, plane: F64, relief_m: F64, grid: F64) -> F64:
    """(2, P, H) height of the ground above the camera, as `CombinedCloud.ground_m`.

    Args:
        places: (2, P, H, 2) x and y, metres in the site frame.
        sloped: (2, P, H) products of these and x and y of the plane's normal.
        origin: (P, 3) the cameras.
        plane: (4,) see `Ground`.
        relief_m: (Y, X) see there.
        grid: (3,) see there.
    """
    found = np.empty(sloped.shape)
    for side in range(2):
        for p in range(sloped.shape[1]):
            for h in range(sloped.shape[2]):
                x, y = places[side, p, h, 0], places[side, p, h, 1]
                relief = between(relief_m, (x - grid[0]) / grid[2], (y - grid[1]) / grid[2])
                above = -(sloped[side, p, h] + plane[3]) / plane[2] + relief
                found[side, p, h] = above - origin[p, 2]
    return found


@compiled(f"Tuple(({MATRIX}, {MATRIX}))({CUBE}, {MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, float64)")
def bearings_between_sides(
    bearing: F64, seen: F64, stds: F64, across_std_m: F64, range_m: F64, bearing_std: float
) -> tuple[F64, F64]:
    """(P, H) bearing of the centre, half a width from either side and nearer to the better known one; (P, H) its error.

    Args:
        bearing: (P, H, 4) of the corners from the ray to the centre.
        seen: (P, 2) bearing of the left edge, and width of the box.
        stds: (P, 4) see `Observed`.
        across_std_m: (P, H) see `placing._Shape`.
        range_m: (P, H) of the centre.
        bearing_std: Standard deviation of the direction in which a camera looks.
    """
    found, std = np.empty(range_m.shape), np.empty(range_m.shape)
    for p in range(range_m.shape[0]):
        first, last = stds[p, 0] * stds[p, 0], stds[p, 2] * stds[p, 2]
        share = last / (first + last)  # of the left side
        for h in range(range_m.shape[1]):
            left, right = bearing[p, h, 0], bearing[p, h, 0]
            for k in range(1, 4):
                left, right = max(left, bearing[p, h, k]), min(right, bearing[p, h, k])
            by_left, by_right = seen[p, 0] - left, (seen[p, 0] - seen[p, 1]) - right
            found[p, h] = share * by_left + (1 - share) * by_right
            by_size = (share - 0.5) * across_std_m[p, h] / range_m[p, h]
            rest = 1 - share
            sum_of_sides = share * share * first + rest * rest * last
            std[p, h] = math.sqrt(sum_of_sides + by_size * by_size + bearing_std * bearing_std)
    return found, std


@compiled(f"Tuple(({CUBE}, {BLOCKS}))({_FIXED_MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, {MATRIX})")
def laid_out(origin: F64, range_m: F64, information: F64, bearing_std: F64, cos: F64, sin: F64) -> tuple[F64, F64]:
    """(P, H, 2) places and (P, H, 2, 2) covariances of ranges in directions.

    Args:
        origin: (P, 3) the cameras.
        range_m: (P, H) metres.
        information: (P, H) of the range's logarithm.
        bearing_std: (P, H) radians.
        cos: (P, H) of the directions.
        sin: (P, H)
    """
    xy, covariances = np.empty((*range_m.shape, 2)), np.empty((*range_m.shape, 2, 2))
    for p in range(range_m.shape[0]):
        for h in range(range_m.shape[1]):
            distance, c, s = range_m[p, h], cos[p, h], sin[p, h]
            side = distance * bearing_std[p, h]
            along, across = distance * distance / information[p, h], side * side
            covariances[p, h, 0, 0] = along * (c * c) + across * (s * s)
            covariances[p, h, 0, 1] = covariances[p, h, 1, 0] = (along - across) * c * s
            covariances[p, h, 1, 1] = along * (s * s) + across * (c * c)
            xy[p, h, 0], xy[p, h, 1] = origin[p, 0] + distance * c, origin[p, 1] + distance * s
    return xy, covariances


@compiled(
    f"{CUBE}({MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, {MATRIX}, {CUBE}, {CUBE}, {CUBE}, {MATRIX}, {MATRIX}, {MATRIX}, "
    f"{MATRIX}, {MATRIX}, float64[::1], float64[::1])"
)
def least_squares(
    range_m: F64,
    contact_m: F64,
    contact_rise_m: F64,
    rise_m: F64,
    back: F64,
    away_m: F64,
    aside_m: F64,
    bearing: F64,
    depth_m: F64,
    depth_std_m: F64,
    across_std_m: F64,
    heights_m: F64,
    seen: F64,
    noise: F64,
    shares: F64,
) -> F64:
    """(4, P, H) step, information, squared error and the product of variances for each heading of each 2D box.

    Args:
        range_m: (P, H) of the centre.
        contact_m: (P, H) range of the contact with the ground.
        contact_rise_m: (P, H) of the ground there.
        rise_m: (P, H) of the ground under the centre.
        back: (P, H) logarithm of the first range over this one.
        away_m: (P, H, 4) of the corners from the camera, along the ray to the centre.
        aside_m: (P, H, 4) of the corners from that ray.
        bearing: (P, H, 4) of the corners from that ray.
        depth_m: (P, H) see `placing._Shape`.
        depth_std_m: (P, H) see there.
        across_std_m: (P, H) see there.
        heights_m: (P, 2) of the object, and its standard deviation.
        seen: (P, 7) slope of the lower and of the upper edge, width, and the standard deviations of left, top, right
            and bottom, see `Observed`.
        noise: (2,) variance of the slope of the ground, and standard deviation of its height.
        shares: (7,) `ROOF_SHARE`, `CONTACT_SHARE`, `SHAPE_STD`, `NEAREST_SHARE`, `FIRST_STD`, its square and the
            inverse of that.
    """
    found = np.empty((4, *range_m.shape))
    roof, contact_share, shape_std, nearest = shares[0], shares[1], shares[2], shares[3]
    for p in range(range_m.shape[0]):
        for h in range(range_m.shape[1]):
            distance, contact, depth = range_m[p, h], contact_m[p, h], depth_m[p, h]
            lower = contact_rise_m[p, h] / contact
            top = rise_m[p, h] + heights_m[p, 0]
            roof_m = max(distance + (-roof if top > 0 else roof) * depth, nearest * distance)
            upper = top / roof_m
            left, right = 0, 0
            for k in range(1, 4):
                left = k if bearing[p, h, k] > bearing[p, h, left] else left
                right = k if bearing[p, h, k] < bearing[p, h, right] else right
            width = bearing[p, h, left] - bearing[p, h, right]
            growth = 0.0
            for k, sign in ((left, 1.0), (right, -1.0)):
                away, aside = away_m[p, h, k], aside_m[p, h, k]
                growth += sign * (-aside / (away * away + aside * aside) * distance)
            e, f, g = seen[p, 0] - lower, seen[p, 1] - upper, seen[p, 2] - width
            s, t = -lower * distance / contact, -upper * distance / roof_m

            ground = noise[1] / distance
            shared = noise[0] + ground * ground
            depth_std, contact_std = shape_std * depth, contact_share * depth_std_m[p, h]
            near, far = lower / contact, upper / roof_m
            high, wide = heights_m[p, 1] / distance, across_std_m[p, h] / distance
            a = shared + near * near * (depth_std * depth_std + contact_std * contact_std) + seen[p, 6] * seen[p, 6]
            c = shared + far * far * (depth_std * depth_std) + high * high + seen[p, 4] * seen[p, 4]
            w = wide * wide + seen[p, 3] * seen[p, 3] + seen[p, 5] * seen[p, 5]
            determinant = a * c - shared * shared
            slopes = (c * s * s + a * t * t - shared * (s * t + t * s)) / determinant + growth * growth / w
            errors = (c * e * e + a * f * f - shared * (e * f + f * e)) / determinant + g * g / w
            both = (c * s * e + a * t * f - shared * (s * f + t * e)) / determinant + growth * g / w
            information, prior = slopes + shares[6], back[p, h] / shares[4]
            found[0, p, h] = (both + back[p, h] / shares[5]) / information
            found[1, p, h] = information
            found[2, p, h] = errors + prior * prior
            found[3, p, h] = determinant * w * information
    return found
