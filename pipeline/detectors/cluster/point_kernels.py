"""The loops of the detector over the points of a frame, and over those of its clusters."""

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64, U8, Bools
from pipeline.core.compiled import compiled

__all__ = ["extents", "hidden_below", "members", "points_above_ground", "totals"]

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
    count, (height, width) = len(rows), relief_m.shape
    place, lidar, link_m = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    position, when_ns = np.empty((count, 3)), np.empty(count)
    kept = 0
    for i in range(count):
        x, y, z = np.float64(xyz[rows[i], 0]), np.float64(xyz[rows[i], 1]), np.float64(xyz[rows[i], 2])
        across = min(max((x - grid[0]) / grid[2], 0.0), width - 1.0)
        along = min(max((y - grid[1]) / grid[2], 0.0), height - 1.0)
        column, line = min(int(across), width - 2), min(int(along), height - 2)
        right, up = across - column, along - line
        near = relief_m[line, column] * (1 - right) + relief_m[line, column + 1] * right
        far = relief_m[line + 1, column] * (1 - right) + relief_m[line + 1, column + 1] * right
        above = z - (-(x * plane[0] + y * plane[1] + plane[3]) / plane[2] + (near * (1 - up) + far * up))
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


@compiled("Tuple((int64[::1], float64[:, ::1], int64[::1]))(int64[::1], int64[::1], int64[::1], int64[::1], int64)")
def totals(weights: I64, lidar: I64, time_sum_ns: I64, starts: I64, lidars: int) -> tuple[I64, F64, I64]:
    """(C,) measured points of each cluster, (C, L) share of them that each lidar measured, and (C,) their mean time.

    Args:
        weights: (N,) number of measured points that each point stands for; sorted by cluster.
        lidar: (N,) that measured these.
        time_sum_ns: (N,) sum of their times.
        starts: (C,) first point of each cluster; each has one.
        lidars: Number L of lidars.
    """
    counts, share = np.empty(len(starts), np.int64), np.zeros((len(starts), lidars))
    time_ns = np.empty(len(starts), np.int64)
    for c in range(len(starts)):
        count, time_sum = 0, 0
        for i in range(starts[c], starts[c + 1] if c + 1 < len(starts) else len(weights)):
            count += weights[i]
            time_sum += time_sum_ns[i]
            share[c, lidar[i]] += weights[i]
        for one in range(lidars):
            share[c, one] /= count
        counts[c], time_ns[c] = count, np.int64(np.rint(time_sum / count))
    return counts, share, time_ns


@compiled("Tuple((int64[::1], int64[::1]))(int64[::1], int64[::1], boolean[::1])")
def members(rows: I64, starts: I64, is_wanted: Bools) -> tuple[I64, I64]:
    """Rows of the points of the wanted ones of C clusters, cluster after cluster; and where each of these begins.

    Args:
        rows: (N,) of the points of all, cluster after cluster.
        starts: (C + 1,) where each of these begins, and N.
        is_wanted: (C,)
    """
    wanted, total = 0, 0
    for c in range(len(is_wanted)):
        if is_wanted[c]:
            wanted += 1
            total += starts[c + 1] - starts[c]
    found, begins, count, k = np.empty(total, np.int64), np.empty(wanted, np.int64), 0, 0
    for c in range(len(is_wanted)):
        if is_wanted[c]:
            begins[k] = count
            k += 1
            for i in range(starts[c], starts[c + 1]):
                found[count] = rows[i]
                count += 1
    return found, begins


@compiled(
    "boolean[::1](int64[::1], float64[::1], float64[::1], float64[::1], int64[::1], float64[::1], float64[::1], "
    "int64[::1], float64, float64[::1])"
)
def hidden_below(
    first: I64,
    distance_m: F64,
    slope: F64,
    height_m: F64,
    sector: I64,
    far_m: F64,
    lidar_height_m: F64,
    starts: I64,
    from_m: float,
    shares: F64,
) -> Bools:
    """(C,) whether clusters are hidden below in enough of the sectors that they extend over, see `Sight`.

    One point of each sector of a cluster, its first, stands for all of them.

    Args:
        first: (S + 1,) first point of each sector of all points.
        distance_m: Of these points from their lidar.
        slope: Of the lines of sight to them.
        height_m: (P,) of the points of the clusters above the ground, cluster after cluster.
        sector: (P,) theirs.
        far_m: (P,) their distance from their lidar.
        lidar_height_m: (P,) height of that.
        starts: (C,) first point of each cluster.
        from_m: What hides is met at least so high.
        shares: What hides is nearer than the first of what is hidden; and a cluster is so in the second of its sectors.
    """
    found, looked = np.empty(len(starts), np.bool_), np.full(len(first), -1, np.int64)
    for c in range(len(starts)):
        end = starts[c + 1] if c + 1 < len(starts) else len(sector)
        bottom_m, lines, hidden = np.inf, 0, 0
        for i in range(starts[c], end):
            bottom_m = min(bottom_m, height_m[i])
        for i in range(starts[c], end):
            if looked[sector[i]] == c:
                continue
            looked[sector[i]] = c
            lines += 1
            for k in range(first[sector[i]], first[sector[i] + 1]):
                meets_m = lidar_height_m[i] + slope[k] * far_m[i]
                if distance_m[k] < shares[0] * far_m[i] and from_m <= meets_m <= bottom_m:
                    hidden += 1
                    break
        found[c] = hidden >= shares[1] * lines
    return found
