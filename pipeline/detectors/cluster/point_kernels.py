"""The loops of the detector over the points of a frame."""

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64, U8
from pipeline.core.compiled import compiled
from pipeline.core.geometry.bilinear import between

__all__ = ["extents", "points_above_ground"]

HALF_ROOT = np.sqrt(0.5)


@compiled(
    "Tuple((int64, int64[::1], float64[:, ::1], int64[::1], float64[::1], float64[::1]))"
    "(Array(float32, 2, 'C', readonly=True), Array(uint8, 1, 'C', readonly=True), "
    "Array(int32, 1, 'C', readonly=True), int64[::1], float64[::1], "
    "Array(float64, 2, 'C', readonly=True), float64[::1], float64[:, ::1], float64[::1], float64[::1])"
)
def points_above_ground(
    xyz: F32,
    lidar_index: U8,
    time_ns: I32,
    rows: I64,
    plane: F64,
    relief_m: F64,
    grid: F64,
    lidar_xyz: F64,
    link: F64,
    heights_m: F64,
) -> tuple[int, I64, F64, I64, F64, F64]:
    """The points between two heights above the ground, with room behind them.

    Args:
        xyz: (N, 3) the cloud, metres in the site frame.
        lidar_index: (N,) lidar of each point.
        time_ns: (N,) its time, minus the cloud's stamp.
        rows: (P,) the points to look at.
        plane: (4,) normal and offset of the ground's plane.
        relief_m: (H, W) see `Relief`.
        grid: (3,) its origin, and the distance between its nodes.
        lidar_xyz: (L, 3) of the lidars in the site frame.
        link: (2,) link distance at a lidar, metres, and how much it grows for a metre of range.
        heights_m: (2,) the points lie above the first and below the second.

    Returns:
        How many they are; (P,) the place of each in `rows`; (P, 3) x, y and height above the ground; (P,) its lidar;
        (P,) its link distance; and (P,) its time.
    """
    count = len(rows)
    place, lidar, link_m = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    position, when_ns = np.empty((count, 3)), np.empty(count)
    kept = 0
    for i in range(count):
        x, y, z = np.float64(xyz[rows[i], 0]), np.float64(xyz[rows[i], 1]), np.float64(xyz[rows[i], 2])
        relief = between(relief_m, (x - grid[0]) / grid[2], (y - grid[1]) / grid[2])
        above = z - (-(x * plane[0] + y * plane[1] + plane[3]) / plane[2] + relief)
        if heights_m[0] < above < heights_m[1]:
            own = np.int64(lidar_index[rows[i]])
            dx, dy, dz = x - lidar_xyz[own, 0], y - lidar_xyz[own, 1], z - lidar_xyz[own, 2]
            place[kept], lidar[kept], when_ns[kept] = i, own, time_ns[rows[i]]
            position[kept, 0], position[kept, 1], position[kept, 2] = x, y, above
            link_m[kept] = link[0] + link[1] * np.sqrt(dx * dx + dy * dy + dz * dz)
            kept += 1
    return kept, place, position, lidar, link_m, when_ns


@compiled(
    "Tuple((int64[::1], int64[::1], int64[::1], float64[:, ::1], float64[:, ::1]))"
    "(float64[:, ::1], int64[::1], int64[::1], int64)"
)
def extents(position: F64, weights: I64, cluster: I64, clusters: int) -> tuple[I64, I64, I64, F64, F64]:
    """The points of clusters, and what these extend over.

    Args:
        position: (N, 3) x, y and height.
        weights: (N,)
        cluster: (N,) of each point.
        clusters: Their number C; each has a point.

    Returns:
        (N,) rows of the points, cluster after cluster; (C + 1,) where each of these begins, and N; (C,) sum of their
        weights; (C, 5) lowest and highest place of the points along x, y, the two diagonals between these, and the
        height.
    """
    starts, total = np.zeros(clusters + 1, np.int64), np.zeros(clusters, np.int64)
    low, high = np.empty((clusters, 5)), np.empty((clusters, 5))
    for c in range(clusters):
        for k in range(5):
            low[c, k], high[c, k] = np.inf, -np.inf
    for i in range(len(cluster)):
        c, x, y = cluster[i], position[i, 0], position[i, 1]
        starts[c + 1] += 1
        total[c] += weights[i]
        for k in range(5):
            place = x
            if k == 1:
                place = y
            elif k == 2:
                place = (x + y) * HALF_ROOT
            elif k == 3:
                place = (x - y) * HALF_ROOT
            elif k == 4:
                place = position[i, 2]
            low[c, k], high[c, k] = min(low[c, k], place), max(high[c, k], place)
    rows, end = np.empty(len(cluster), np.int64), np.empty(clusters, np.int64)
    for c in range(clusters):
        starts[c + 1] += starts[c]
        end[c] = starts[c]
    for i in range(len(cluster)):
        c = cluster[i]
        rows[end[c]] = i
        end[c] += 1
    return rows, starts, total, low, high
