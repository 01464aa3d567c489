"""The points that lie where 2D boxes look, and which of them are those of the object that a 2D box shows.

What stands in front of the object, and behind it, is in the frustum too. The points are linked as those of a cluster
are, within each frustum. Of the resulting segments, the one is taken that fills the 2D box best and lies where the size
of the class and the ground place the object.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Table, first_of_runs
from lidcam.pipeline.core.geometry.regions import points_in_regions
from lidcam.pipeline.detectors.cluster.clusters import HEIGHT_WEIGHT, cluster_points, thin_points
from lidcam.pipeline.fusion.cameras.sightings import Sightings

SHRINK_SHARE = 0.03
"""A frustum is narrower than its 2D box by this share at either side: edges of boxes stand off, and show what is
behind."""

APART_M = 1e4
"""Frustums are laid out this far from each other, so that all are linked at once and none to another."""

THIN_SHARE = 0.2
"""Points in a cell of this share of the link distance become one before they are linked."""

MIN_FILL = 0.1
"""Least share of the 2D box that a segment fills: its width times its height."""

MIN_WIDTH = 0.3
"""Least share of the 2D box's width that a segment fills."""

MAX_OFF = 3.5
"""Largest distance of a segment from where the object is expected, in standard deviations."""


@dataclass(frozen=True, eq=False)
class FrustumPoints(Table):
    """P points in frustums, frustum after frustum; a point may be in several.

    Attributes:
        rows: (P,) int64 row of each in the cloud, rising within a frustum.
        group: (P,) int64 the frustum.
        share_x: (P,) float64 where it is between the left side of the frustum, 0, and the right one, 1.
        share_y: (P,) float64 the same from top to bottom.
        along_m: (P,) float64 horizontal distance from the camera, in the direction of the frustum's middle.
    """

    rows: I64
    group: I64
    share_x: F64
    share_y: F64
    along_m: F64


def points_in_frustums(xyz: F32, sightings: Sightings, nearest_m: F64, furthest_m: F64) -> FrustumPoints:
    """The points of a cloud in the frustum of each 2D box, between two distances.

    A frustum is bounded by planes: where a lens bends the sides of a box, by those around all of it.

    Args:
        xyz: (N, 3) metres in the site frame.
        sightings: F 2D boxes.
        nearest_m: (F,) least horizontal distance from the camera, along the middle of the box.
        furthest_m: (F,) largest one.
    """
    rays = sightings.rays @ sightings.views.rotations.swapaxes(1, 2)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SHRINK_SHARE * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    rows, group = points_in_regions(xyz, _sides(sightings, low, high, nearest_m, furthest_m))
    points, views = xyz.take(rows, 0).astype(np.float64), sightings.views
    ahead = (views.rotations.take(group, 0) @ points[:, :, None])[..., 0] + views.translations.take(group, 0)
    share_x, share_y = ((ahead[:, :2] / ahead[:, 2:] - low.take(group, 0)) / (high - low).take(group, 0)).T
    (x, y, _), (ahead_x, ahead_y) = (points - sightings.origin.take(group, 0)).T, heading_of(sightings).take(group, 0).T
    return FrustumPoints(rows, group, share_x, share_y, x * ahead_x + y * ahead_y)


def heading_of(sightings: Sightings) -> F64:
    """(P, 2) unit vectors from the camera to the middle of each 2D box, seen from above."""
    middle = sightings.rays[:, 3] + sightings.rays[:, 7]
    return np.asarray(middle[:, :2] / np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)[:, None])


def _sides(sightings: Sightings, low: F64, high: F64, nearest_m: F64, furthest_m: F64) -> F64:
    """(F, 7, 4) planes around each frustum, see `points_in_regions`.

    Args:
        sightings: F 2D boxes.
        low: (F, 2) least x / z and y / z in the optical frame.
        high: (F, 2) largest ones.
        nearest_m: See `points_in_frustums`.
        furthest_m: See there.
    """
    right, down, ahead = np.concatenate(
        [sightings.views.rotations, sightings.views.translations[..., None]], 2
    ).transpose(1, 0, 2)
    level = np.zeros((len(sightings), 4))
    level[:, :2] = heading_of(sightings)
    level[:, 3] = -(level[:, :2] * sightings.origin[:, :2]).sum(1)
    end = np.array([0.0, 0.0, 0.0, 1.0])
    planes = [
        right - low[:, :1] * ahead,
        high[:, :1] * ahead - right,
        level - nearest_m[:, None] * end,
        furthest_m[:, None] * end - level,
        down - low[:, 1:] * ahead,
        high[:, 1:] * ahead - down,
        ahead,
    ]
    return np.stack(planes, 1)


class Expected(NamedTuple):
    """Expected place and extent of the object in each of F frustums.

    Attributes:
        front_m: (F,) float64 horizontal distance of its near side from the camera.
        front_std_m: (F,) float64
        reach_m: (F,) float64 how far its points may lie behind the nearest one.
        clear_share: (F,) float64 share of its height, from the ground up, in which no points are left.
        gap_share: (F,) float64 distance between points there, as a share of its height: between the beams of a lidar
            it is not known how far up and down an object goes on.
    """

    front_m: F64
    front_std_m: F64
    reach_m: F64
    clear_share: F64
    gap_share: F64


class Segments(NamedTuple):
    """The chosen segments of G frustums, at most one of each.

    Attributes:
        group: (G,) int64 frustum of each, rising.
        points: (P,) int64 rows of the `FrustumPoints`, segment after segment.
        starts: (G,) int64 first of `points` of each segment.
        worth: (G,) float64 how well the segment suits the 2D box; larger is better.
    """

    group: I64
    points: I64
    starts: I64
    worth: F64


def choose_segments(xyz: F32, found: FrustumPoints, link_m: F64, expected: Expected, min_points: int) -> Segments:
    """The segment of each frustum that is most likely its object; none where there is no fitting one.

    Args:
        xyz: (N, 3) the cloud.
        found: P of its points in F frustums, above the ground.
        link_m: (P,) points nearer to each other than this belong together.
        expected: Of each frustum.
        min_points: A segment of fewer points is noise.
    """
    none = np.zeros(0, np.int64)
    if not len(found):
        return Segments(none, none, none, np.zeros(0))
    number, segment = _linked(xyz, found, link_m)
    segment_m = np.lexsort([found.along_m, segment])
    counts = np.bincount(segment, minlength=number)
    starts = np.cumsum(counts) - counts
    # The front is where the nearest tenth of the points ends: one stray point is not an object's side.
    group, front = found.group[segment_m[starts]], found.along_m[segment_m[starts + counts // 10]]
    is_within = found.along_m <= (front + expected.reach_m[group])[segment]
    counts = np.bincount(segment[is_within], minlength=number)
    order = segment_m[is_within[segment_m]]
    starts = np.cumsum(counts) - counts
    wide, high = (
        np.maximum.reduceat(share, starts) - np.minimum.reduceat(share, starts)
        for share in (found.share_x[order], found.share_y[order])
    )
    high = np.minimum((high + expected.gap_share[group]) / (1.0 - expected.clear_share[group]), 1.0)
    off = (front - expected.front_m[group]) / expected.front_std_m[group]
    sound = (counts >= min_points) & (wide >= MIN_WIDTH) & (wide * high >= MIN_FILL) & (np.abs(off) <= MAX_OFF)
    worth = np.where(sound, 2 * np.log(np.maximum(wide * high, MIN_FILL)) - off**2 / 2, -np.inf)
    best = np.lexsort((front, -worth, group))
    best = best[first_of_runs(group[best])]
    best = best[np.isfinite(worth[best])]
    rank = np.full(number, -1)
    rank[best] = np.arange(len(best))
    points = np.flatnonzero(is_within & (rank[segment] >= 0))
    points = points[np.argsort(rank[segment[points]], kind="stable")]
    return Segments(group[best], points, np.cumsum(counts[best]) - counts[best], worth[best])


def _linked(xyz: F32, found: FrustumPoints, link_m: F64) -> tuple[int, I64]:
    """The number of segments, and (P,) that of each point; no segment is in two frustums."""
    position = xyz.take(found.rows, axis=0).astype(np.float64)
    position[:, 2] *= HEIGHT_WEIGHT
    cells = thin_points(position, link_m, THIN_SHARE, found.group)
    means = cells.means.copy()
    means[:, 0] += APART_M * found.group[cells.first]
    number, segment = cluster_points(means, cells.distance_m)
    return number, segment.take(cells.cell_of_point)
