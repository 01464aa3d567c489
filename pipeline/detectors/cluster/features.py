"""Features of the points in and around a box, which mean the same for every lidar and range."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.log_odds import logit
from lidcam.pipeline.native.kernels import box_shapes

REACH_M = 1.0
"""Distance from a box up to which points are looked at: a wall, a hedge and a pole go on there, and a car does not."""

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

SLENDER = [KINDS.index("pedestrian"), KINDS.index("cyclist")]
"""Kinds that are completed upwards (`complete_boxes`): a height counts as far as it was seen."""

WHOLE_SHARE = 0.8
"""Minimum share of such a height that was seen; of a lower part, the height is that of the class, as in
`pipeline/native/boxes.cpp`."""


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
    placed = np.column_stack([boxes.centers[:, :2], boxes.sizes])
    counts, found[:, SHAPE:] = box_shapes(position, starts, placed, heading, sight, REACH_M)
    top = found[:, SHAPE + 2]
    is_between = np.isin(kinds, SLENDER) & (top >= WHOLE_SHARE * boxes.sizes[:, 2])
    found[is_between, 4] = np.minimum(boxes.sizes[:, 2], top)[is_between]
    points = np.log1p(counts[:, 0])
    found[:, 10], found[:, 11] = points, points + 2 * np.log(range_m)
    found[:, 12:SHAPE] = np.log1p(counts[:, 1:]) - points[:, None]
    return found
