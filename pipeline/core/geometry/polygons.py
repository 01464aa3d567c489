"""Points in polygons, and parts of polygons."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64


def first_polygon_with(polygons: Sequence[F64], points: F64) -> I64:
    """(N,) row of the first polygon that contains each point (N, 2), -1 if none does; points on an edge are inside.

    Polygons have corners (K, 2) in either direction, and may be concave.
    """
    rows = np.full(len(points), -1, np.int64)
    for row, polygon in reversed(list(enumerate(polygons))):
        start, end = polygon, np.concatenate([polygon[1:], polygon[:1]])
        x, y = points[:, :1], points[:, 1:]
        along = end - start
        # > 0: the point lies left of the edge
        side = along[:, 0] * (y - start[:, 1]) - along[:, 1] * (x - start[:, 0])
        crosses = (start[:, 1] <= y) != (end[:, 1] <= y)
        inside = (crosses & ((side > 0) == (along[:, 1] > 0))).sum(1) % 2 == 1
        rows[inside] = row
        in_line = side == 0
        if in_line.any():
            low, high = np.minimum(start, end), np.maximum(start, end)
            in_span = (x >= low[:, 0]) & (x <= high[:, 0]) & (y >= low[:, 1]) & (y <= high[:, 1])
            rows[(in_line & in_span).any(1)] = row
    return rows


def clipped_polygon(polygon: F64, low: F64, high: F64) -> F64:
    """The part of a polygon (K, 2) within bounds (2,), as (M, 2) corners; none where no part of it is.

    One side after the other is cut off (Sutherland and Hodgman, Reentrant polygon clipping, 1974); parts of a concave
    polygon stay joined along the bounds.
    """
    for axis, bound, sign in ((0, low[0], 1.0), (1, low[1], 1.0), (0, high[0], -1.0), (1, high[1], -1.0)):
        inside = sign * (polygon[:, axis] - bound)
        after, inside_after = np.roll(polygon, -1, 0), np.roll(inside, -1)
        crosses = (inside >= 0) != (inside_after >= 0)
        share = inside / np.where(crosses, inside - inside_after, 1.0)
        corners = np.stack([polygon, polygon + share[:, None] * (after - polygon)], 1)
        polygon = corners[np.stack([inside >= 0, crosses], 1)]
    return polygon
