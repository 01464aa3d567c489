"""Features of the points in and around a box, which mean the same for every lidar and range."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.compiled import compiled
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.detectors.log_odds import logit

REACH_M = 1.0
"""Distance from a box up to which points are looked at: a wall, a hedge and a pole go on there, and a car does not."""

MARGIN_M = 0.15
"""Distance from a box up to which points are of the object: its surface is rough, and the box fits not quite."""

ABOVE_M = 2.0
"""Height above an object up to which points are looked at."""

LAYERS_M = np.array([0.3, 0.6, 0.9, 1.2, 1.5, 1.9])
"""Heights above the ground between which shares of the points are counted."""

PROFILES_M = np.array([0.0, 0.6, 1.2, 1.9])
"""Heights above the ground between which extents are measured."""

FEATURES = (
    *("score", "range", "length", "width", "height", "car", "pedestrian", "cyclist", "large", "turn"),
    *("points", "density", "at_ends", "at_sides", "nearer", "farther", "around_high", "above"),
    *("low", "mean", "top", "spread", *(f"layer{row}" for row in range(7))),
    *("thin", "lean", "long", "along", "across", "on_axis"),
    *(f"profile{row}{axis}" for row in range(3) for axis in "xy"),
    *("side", "side_spread", "inside"),
)
"""Names of the columns."""

SHAPE = FEATURES.index("low")


def box_features(boxes: Boxes3D, kinds: I64, position: F64, starts: I64, lidar_xy: F64) -> F64:
    """(B, F) numbers of each box; its points in a frame of its own, length along x, on the ground.

    Args:
        boxes: B boxes that stand on the ground.
        kinds: (B,) which road user the cluster was taken for: 1 car, 2 pedestrian, 3 cyclist, 4 large vehicle.
        position: (P, 3) x and y in the site frame and height above the ground of the points that are within `REACH_M`
            of a box, sorted by box, metres.
        starts: (B + 1,) first point of each box, and P.
        lidar_xy: (L, 2) of the lidars in the site frame.
    """
    found = np.zeros((len(starts) - 1, len(FEATURES)))
    to_lidar = lidar_xy - boxes.centers[:, None, :2]
    range_m = np.linalg.norm(to_lidar, axis=2)
    nearest = range_m.argmin(1)
    rows = np.arange(len(nearest))
    range_m, to_lidar = np.maximum(range_m[rows, nearest], 1.0), to_lidar[rows, nearest]
    heading = np.column_stack([np.cos(boxes.yaws), np.sin(boxes.yaws)])
    sight = np.column_stack(
        [(heading * to_lidar).sum(1), heading[:, 0] * to_lidar[:, 1] - heading[:, 1] * to_lidar[:, 0]]
    )
    sight /= np.maximum(np.linalg.norm(sight, axis=1), 1e-9)[:, None]
    found[:, 0], found[:, 1], found[:, 2:5] = logit(boxes.scores.astype(np.float64)), np.log(range_m), boxes.sizes
    found[rows, 4 + kinds] = 1.0
    found[:, 9] = np.abs(sight[:, 0])
    counts = _shapes(position, starts, np.column_stack([boxes.centers[:, :2], boxes.sizes]), heading, sight, found)
    points = np.log1p(counts[:, 0])
    found[:, 10], found[:, 11] = points, points + 2 * np.log(range_m)
    found[:, 12:SHAPE] = np.log1p(counts[:, 1:]) - points[:, None]
    return found


@compiled(
    "float64[:, ::1](float64[:, ::1], int64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])"
)
def _shapes(position: F64, starts: I64, placed: F64, heading: F64, sight: F64, found: F64) -> F64:
    """(B, 7) numbers of points inside, at the ends, at the sides, nearer, farther, high beside and above each box.

    Writes the columns from `low` on of `found` (B, F). `placed` (B, 5) are x and y of the centre and the size of each
    box, `heading` (B, 2) is along its length, and `sight` (B, 2) to the nearest lidar, in the frame of the box.
    """
    counts = np.zeros((len(placed), 7))
    local = np.empty((len(position), 3))
    for b in range(len(placed)):
        half_x, half_y, high = placed[b, 2] / 2, placed[b, 3] / 2, placed[b, 4] + MARGIN_M
        n, top = 0, 0.0
        for i in range(starts[b], starts[b + 1]):
            dx, dy, z = position[i, 0] - placed[b, 0], position[i, 1] - placed[b, 1], position[i, 2]
            x, y = heading[b, 0] * dx + heading[b, 1] * dy, heading[b, 0] * dy - heading[b, 1] * dx
            off_x, off_y = abs(x) - half_x, abs(y) - half_y
            if off_x <= MARGIN_M and off_y <= MARGIN_M:
                if z <= high:
                    local[n, 0], local[n, 1], local[n, 2] = x, y, z
                    top = max(top, z)
                    n += 1
                elif z <= high + ABOVE_M:
                    counts[b, 6] += 1
            elif off_x <= REACH_M and off_y <= REACH_M and z < 3.0:
                if z > 1.2:
                    counts[b, 5] += 1
                if off_y <= MARGIN_M:
                    counts[b, 1] += 1
                elif off_x <= MARGIN_M:
                    counts[b, 2] += 1
                if x * sight[b, 0] + y * sight[b, 1] > 0:
                    counts[b, 3] += 1
                else:
                    counts[b, 4] += 1
        counts[b, 0] = n
        if n < 3:
            continue
        column = SHAPE
        mean_x = mean_y = mean_z = 0.0
        low = np.inf
        for i in range(n):
            mean_x += local[i, 0] / n
            mean_y += local[i, 1] / n
            mean_z += local[i, 2] / n
            low = min(low, local[i, 2])
            layer = 0
            while layer < 6 and local[i, 2] >= LAYERS_M[layer]:
                layer += 1
            found[b, column + 4 + layer] += 1 / n
        xx = xy = yy = zz = 0.0
        side = side_square = inside = 0.0
        for i in range(n):
            x, y, z = local[i, 0] - mean_x, local[i, 1] - mean_y, local[i, 2] - mean_z
            xx += x * x / n
            xy += x * y / n
            yy += y * y / n
            zz += z * z / n
            depth = abs(min(half_x - abs(local[i, 0]), half_y - abs(local[i, 1])))
            side += depth / n
            side_square += depth * depth / n
            inside += (depth > 0.3) / n
        found[b, column], found[b, column + 1], found[b, column + 2] = low, mean_z, top
        found[b, column + 3] = np.sqrt(zz)
        column += 11
        # The principal axes seen from above.
        half, gap = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
        long, short = half + gap, max(half - gap, 0.0)
        axis_x, axis_y = (long - yy, xy) if xx > yy else (xy, long - xx)
        norm = np.sqrt(axis_x * axis_x + axis_y * axis_y)
        if norm > 0:
            axis_x, axis_y = axis_x / norm, axis_y / norm
        else:
            axis_x, axis_y = 1.0, 0.0
        least = np.full((4, 2), np.inf)
        largest = np.full((4, 2), -np.inf)
        on_axis, scatter = 0.0, 0.0
        for i in range(n):
            x, y = local[i, 0] - mean_x, local[i, 1] - mean_y
            along, across = x * axis_x + y * axis_y, y * axis_x - x * axis_y
            on_axis += (abs(across) < 0.1) / n
            scatter += across * (local[i, 2] - mean_z) / n
            layer = 0
            while layer < 3 and local[i, 2] >= PROFILES_M[layer + 1]:
                layer += 1
            for row in (layer, 3):
                if row == 3 or layer < 3:
                    least[row, 0], largest[row, 0] = min(least[row, 0], along), max(largest[row, 0], along)
                    least[row, 1], largest[row, 1] = min(least[row, 1], across), max(largest[row, 1], across)
        found[b, column], found[b, column + 1], found[b, column + 2] = np.sqrt(short), scatter, np.sqrt(long)
        found[b, column + 3], found[b, column + 4] = largest[3, 0] - least[3, 0], largest[3, 1] - least[3, 1]
        found[b, column + 5] = on_axis
        column += 6
        for row in range(3):
            for axis in range(2):
                seen = largest[row, axis] >= least[row, axis]
                found[b, column] = largest[row, axis] - least[row, axis] if seen else -0.5
                column += 1
        found[b, column], found[b, column + 2] = side, inside
        found[b, column + 1] = np.sqrt(max(side_square - side * side, 0.0))
    return counts
