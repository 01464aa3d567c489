"""The points in the frustums of 2D boxes, and the segment of them that is the object of the 2D box.

Objects in front and behind are in the frustum too. The points are linked within each frustum as in a cluster. The
segment is taken that fills the 2D box best, and is nearest to the position expected from class size and ground.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Table, first_of_runs
from lidcam.pipeline.core.geometry.regions import points_in_regions
from lidcam.pipeline.detectors.cluster.clusters import HEIGHT_WEIGHT, cluster_points, thin_points
from lidcam.pipeline.detectors.cluster.fitting import THIN_SHARE
from lidcam.pipeline.fusion.cameras.sightings import Sightings

SIDE_MARGIN = 0.03
"""Margin of a frustum at either side, as a share of the 2D box: its edges stand off, and show the background."""

FRUSTUM_SPACING_M = 1e4
"""Spacing of the frustums, so that all are linked at once and none to another, metres."""

MIN_FILL = 0.1
"""Minimum share of the 2D box that a segment fills: its width times its height."""

MIN_WIDTH = 0.3
"""Minimum share of the 2D box's width that a segment fills."""

MAX_DISTANCE = 3.5
"""Maximum distance of a segment from the expected position of the object, in standard deviations."""


@dataclass(frozen=True, eq=False)
class FrustumPoints(Table):
    """P points in frustums, frustum after frustum; a point may be in several."""

    rows: I64  # (P,) int64 row of each in the cloud, rising within a frustum
    group: I64  # (P,) int64 the frustum
    share_x: F64  # (P,) float64 position in the upright image between the left side of the frustum, 0, and the right, 1
    share_y: F64  # (P,) float64 position from top, 0, to bottom, 1
    along_m: F64  # (P,) float64 horizontal distance from the camera, in the direction of the frustum's middle


def points_in_frustums(xyz: F32, sightings: Sightings, min_m: F64, max_m: F64) -> FrustumPoints:
    """The points of a cloud in the frustum of each 2D box, between two distances.

    A frustum is bounded by planes; where a lens bends the sides of a box, by those around all of it.

    Args:
        xyz: (N, 3) metres in the site frame.
        sightings: F 2D boxes.
        min_m: (F,) minimum horizontal distance from the camera, along the middle of the box.
        max_m: (F,) maximum distance.
    """
    rotations, translations = sightings.T_camera_site[..., :3], sightings.T_camera_site[..., 3]
    rays = sightings.rays @ rotations.swapaxes(1, 2)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SIDE_MARGIN * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    rows, group = points_in_regions(xyz, _sides(sightings, low, high, min_m, max_m))
    points = xyz.take(rows, 0).astype(np.float64)
    ahead = (rotations.take(group, 0) @ points[:, :, None])[..., 0] + translations.take(group, 0)
    share_x, share_y = ((ahead[:, :2] / ahead[:, 2:] - low.take(group, 0)) / (high - low).take(group, 0)).T
    (x, y, _), (ahead_x, ahead_y) = (points - sightings.origin.take(group, 0)).T, sightings.headings.take(group, 0).T
    return FrustumPoints(rows, group, share_x, share_y, x * ahead_x + y * ahead_y)


def _sides(sightings: Sightings, low: F64, high: F64, min_m: F64, max_m: F64) -> F64:
    """(F, 7, 4) planes around each frustum, as in `points_in_regions`.

    `low` and `high` (F, 2) bound x / z and y / z in the optical frame.
    """
    right, down, ahead = sightings.T_camera_site.transpose(1, 0, 2)
    level = np.zeros((len(sightings), 4))
    level[:, :2] = sightings.headings
    level[:, 3] = -(level[:, :2] * sightings.origin[:, :2]).sum(1)
    end = np.array([0.0, 0.0, 0.0, 1.0])
    planes = [
        right - low[:, :1] * ahead,
        high[:, :1] * ahead - right,
        level - min_m[:, None] * end,
        max_m[:, None] * end - level,
        down - low[:, 1:] * ahead,
        high[:, 1:] * ahead - down,
        ahead,
    ]
    return np.stack(planes, 1)


class Expected(NamedTuple):
    """Expected position and extent of the object in each of F frustums."""

    front_m: F64  # (F,) float64 horizontal distance of its near side from the camera
    front_std_m: F64  # (F,) float64 standard deviation of that distance
    reach_m: F64  # (F,) float64 maximum distance of its points behind the nearest one
    clear_share: F64  # (F,) float64 share of its height, from the ground up, without points
    # (F,) float64 distance between points there, as a share of its height: an object may continue up and down to the
    # next beams of the lidar
    gap_share: F64


class Segments(NamedTuple):
    """The chosen segments of G frustums, at most one of each."""

    group: I64  # (G,) int64 frustum of each, rising
    points: I64  # (P,) int64 rows of the `FrustumPoints`, segment after segment
    starts: I64  # (G,) int64 first of `points` of each segment
    worth: F64  # (G,) float64 log likelihood of the segment given the 2D box, up to a constant


def choose_segments(xyz: F32, found: FrustumPoints, link_m: F64, expected: Expected, min_points: int) -> Segments:
    """The segment of each frustum that is most likely its object, if any fits.

    Args:
        xyz: (N, 3) the cloud.
        found: P of its points in F frustums, above the ground.
        link_m: (P,) link distances.
        expected: Expectation for each frustum.
        min_points: Minimum number of points of a segment.
    """
    none = np.zeros(0, np.int64)
    if not len(found):
        return Segments(none, none, none, np.zeros(0))
    number, segment = _linked(xyz, found, link_m)
    segment_m = np.lexsort([found.along_m, segment])
    counts = np.bincount(segment, minlength=number)
    starts = np.cumsum(counts) - counts
    # The front is at the nearest tenth of the points: one stray point is not an object's side.
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
    distance = (front - expected.front_m[group]) / expected.front_std_m[group]
    sound = (
        (counts >= min_points) & (wide >= MIN_WIDTH) & (wide * high >= MIN_FILL) & (np.abs(distance) <= MAX_DISTANCE)
    )
    worth = np.where(sound, 2 * np.log(np.maximum(wide * high, MIN_FILL)) - distance**2 / 2, -np.inf)
    best = np.lexsort((front, -worth, group))
    best = best[first_of_runs(group[best])]
    best = best[np.isfinite(worth[best])]
    rank = np.full(number, -1)
    rank[best] = np.arange(len(best))
    points = np.flatnonzero(is_within & (rank[segment] >= 0))
    points = points[np.argsort(rank[segment[points]], kind="stable")]
    return Segments(group[best], points, np.cumsum(counts[best]) - counts[best], worth[best])


def _linked(xyz: F32, found: FrustumPoints, link_m: F64) -> tuple[int, I64]:
    """The number of segments, and (P,) the segment of each point; no segment is in two frustums."""
    position = xyz.take(found.rows, axis=0).astype(np.float64)
    position[:, 2] *= HEIGHT_WEIGHT
    cells = thin_points(position, link_m, THIN_SHARE, found.group)
    means = cells.means.copy()
    means[:, 0] += FRUSTUM_SPACING_M * found.group[cells.first]
    number, segment = cluster_points(means, cells.distance_m)
    return number, segment.take(cells.cell_of_point)
