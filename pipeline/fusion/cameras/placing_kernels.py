"""The least squares of `placing.py`: everything between the functions whose last bit differs between machines."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled

__all__ = ["least_squares"]

MATRIX = "float64[:, ::1]"
CUBE = "float64[:, :, ::1]"


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
