"""The sums of `box_prior.py`, compiled."""

import math

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["guessed_covariances", "prior_covariances"]

_MASK = "Array(boolean, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))


@compiled(f"float64[:, :, ::1]({_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, {_LIST})")
def guessed_covariances(covariances: F64, centers: F64, sizes: F64, lidar_xy: F64, guess: F64) -> F64:
    """See `box_prior.known_covariances`.

    Args:
        covariances: (N, 3, 3), zeros where unknown.
        centers: (N, 3).
        sizes: (N, 3).
        lidar_xy: (L, 2).
        guess: (5,) `UNKNOWN_SHARE`, `UNKNOWN_PER_M`, `UNKNOWN_YAW_RAD`, `ANY_YAW_RAD`, `SQUARE`.
    """
    found = covariances.copy()
    for n in range(len(centers)):
        if np.any(covariances[n] != 0):
            continue
        length, width = max(sizes[n, 0], sizes[n, 1]), min(sizes[n, 0], sizes[n, 1])
        away = np.inf
        for lidar in range(len(lidar_xy)):
            x, y = centers[n, 0] - lidar_xy[lidar, 0], centers[n, 1] - lidar_xy[lidar, 1]
            away = min(away, math.sqrt(x * x + y * y))
        place = guess[0] * width + guess[1] * (away if np.isfinite(away) else 0.0)
        shows = min(max((length / width - 1) / (guess[4] - 1), 0.0), 1.0)
        yaw = guess[3] + shows * (guess[2] - guess[3])
        found[n, 0, 0] = found[n, 1, 1] = place * place
        found[n, 2, 2] = yaw * yaw
    return found


@inlined
def _free_variances(C: F64, cos: float, sin: float) -> tuple[float, float]:
    """Variances of the centre along length and width that are independent of the yaw and of each other.

    Taken away from the covariances C of x, y, yaw, they leave a matrix without negative eigenvalues.
    """
    xx, xy = C[0, 0] - C[0, 2] * C[0, 2] / C[2, 2], C[0, 1] - C[0, 2] * C[1, 2] / C[2, 2]
    yx, yy = C[1, 0] - C[1, 2] * C[0, 2] / C[2, 2], C[1, 1] - C[1, 2] * C[1, 2] / C[2, 2]
    along = cos * xx * cos + cos * xy * sin + sin * yx * cos + sin * yy * sin
    both = cos * xx * -sin + cos * xy * cos + sin * yx * -sin + sin * yy * cos
    across = -sin * xx * -sin + -sin * xy * cos + cos * yx * -sin + cos * yy * cos
    along, across, both = max(along, 1e-12), max(across, 1e-12), abs(both)
    return max(along - both * math.sqrt(along / across), 0.0), max(across - both * math.sqrt(across / along), 0.0)


@inlined
def _nearer_end(n: int, centers: F64, sizes: F64, cos: float, sin: float, lidar_xy: F64) -> tuple[float, float]:
    """Along length and width: 1 where all lidars are beyond the front or left end, -1 the other, 0 beside.

    Lidars count by the inverse square of their distance, as their points do.
    """
    total, along, across = 0.0, 0.0, 0.0
    for turn in range(2):  # the sum of the weights comes first
        for lidar in range(len(lidar_xy)):
            x, y = lidar_xy[lidar, 0] - centers[n, 0], lidar_xy[lidar, 1] - centers[n, 1]
            weight = 1 / max(x * x + y * y, 1e-3)
            if turn == 0:
                total += weight
            else:
                along += weight / total * min(max((x * cos + y * sin) / (sizes[n, 0] / 2), -1.0), 1.0)
                across += weight / total * min(max((x * -sin + y * cos) / (sizes[n, 1] / 2), -1.0), 1.0)
    return along, across


@compiled(
    "Tuple((float64[:, :, ::1], float64[::1], float64[::1]))"
    f"({_BLOCK}, {_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_MASK}, {_TABLE}, {_LIST})"
)
def prior_covariances(
    known: F64, centers: F64, sizes: F64, cosines: F64, sines: F64, is_seen: Bools, lidar_xy: F64, limits: F64
) -> tuple[F64, F64, F64]:
    """The fields of `BoxPrior`, but for `information`.

    Args:
        known: (N, 3, 3) covariances of x, y and yaw, none of them unknown.
        centers: (N, 3).
        sizes: (N, 3).
        cosines: (N,) of the yaws.
        sines: (N,) of these.
        is_seen: (N,) whether lidars have seen the box; else cameras placed it.
        lidar_xy: (L, 2).
        limits: (10,) smallest standard deviation of the place as a share of the width; smallest and largest variance of
            the yaw; largest share that is explained; smallest anchor; largest variance of the size, smallest ones of
            sizes that are seen and of others, all as shares; speed in extents per second; variance of headings.
    """
    least_share, least_yaw, most_yaw, explained, least_anchor = limits[0], limits[1], limits[2], limits[3], limits[4]
    most_size, seen_size, class_size, speed_per_s, heading = limits[5], limits[6], limits[7], limits[8], limits[9]
    count = len(known)
    found, shares, rests = np.zeros((count, 7, 7)), np.empty(count), np.empty(count)
    for n in range(count):
        C, cos, sin = found[n], cosines[n], sines[n]
        for i in range(3):
            for k in range(3):  # numba takes seconds to compile a slice that is set to an array
                C[i, k] = known[n, i, k]
        C[2, 2] = min(max(known[n, 2, 2], least_yaw), most_yaw)
        shrunk = math.sqrt(C[2, 2] / max(known[n, 2, 2], 1e-12))
        least = least_share * min(sizes[n, 0], sizes[n, 1])
        for i in range(2):
            C[i, 2] *= shrunk
            C[2, i] *= shrunk
            C[i, i] += least * least

        # A side that no lidar saw makes the variances along length and width differ: that comes from the size.
        left = _free_variances(C, cos, sin)
        ends = _nearer_end(n, centers, sizes, cos, sin, lidar_xy) if is_seen[n] else (0.0, 0.0)
        turn = (cos, -sin), (sin, cos)
        too_wide = np.empty(2)
        for axis in range(2):
            anchor, extent = ends[axis] / 2, sizes[n, axis]
            grown = min(left[axis] - min(left[0], left[1]), explained * left[axis])
            reach = max(abs(anchor), least_anchor)
            size = min(most_size, grown / (reach * reach) / (extent * extent))
            own_least = min(seen_size if is_seen[n] else class_size, most_size)
            size = max(max(size, own_least), 1e-6) * (extent * extent)
            size = min(size, max(explained * left[axis] / max(anchor * anchor, 1e-9), 1e-6 * (extent * extent)))
            too_wide[axis] = max(grown - anchor * anchor * size, 0.0) if abs(anchor) > least_anchor else 0.0
            shared = anchor * size
            if anchor * shared > left[axis]:  # even the smallest variance of the size is more than the centre's
                shared = math.copysign(math.sqrt(explained * left[axis] * size), anchor)
            C[3 + axis, 3 + axis] = size
            for i in range(2):
                C[i, 3 + axis] = C[3 + axis, i] = -(turn[i][axis] * shared)
        for i in range(2):
            for k in range(2):
                C[i, k] -= turn[i][0] * too_wide[0] * turn[k][0] + turn[i][1] * too_wide[1] * turn[k][1]

        speed = speed_per_s * math.sqrt(sizes[n, 0] * sizes[n, 1])
        aside = speed * min(sizes[n, 0], sizes[n, 1]) / max(sizes[n, 0], sizes[n, 1])
        C[5, 5], C[6, 6] = speed * speed, aside * aside
        own = C[2, 2]
        C[2, 2] += heading
        shares[n] = own / C[2, 2]
        rests[n] = own * (1 - shares[n])
    return found, shares, rests
