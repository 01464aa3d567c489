"""The engine: from the points above the ground to proposed boxes; what is hidden below, or hangs in the air."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, select_rows
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.clusters import HEIGHT_WEIGHT, cluster_points
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter, Fitted, ThinnedPoints, rows_of
from lidcam.pipeline.detectors.protocols import Candidates3D

SECTOR_RAD = np.deg2rad(1.0)
"""Width of a sector, within which points stand in one line of sight, roughly."""

SECTORS = int(2 * np.pi / SECTOR_RAD) + 2
"""Sectors of a lidar, with room for rounding."""

MAX_NEARER_SHARE = 0.97
"""Maximum distance of a point that hides another, as a share of the other's distance."""

MIN_HIDDEN_SHARE = 0.5
"""Minimum share of a cluster's sectors in which it is hidden below, for it to count as hidden."""


class Sight(NamedTuple):
    """All points of a frame, by lidar and azimuth."""

    origins: F64  # (L, 3) x, y of the lidars in the site frame and their heights above the ground, metres
    starts: I64  # (S + 1,) first point of each sector, lidar after lidar
    distance_m: F64  # (N,) horizontal distance of each point from its lidar, sector after sector
    slope: F64  # (N,) rise of the line of sight to each for a metre of that distance

    @classmethod
    def of(cls, position: F64, lidar: I64, origins: F64) -> "Sight":
        """From points (N, 3) x, y and height above the ground, and the lidar (N,) of each."""
        sector, distance_m, slope = _seen(position, lidar, origins)
        # Numpy sorts numbers of 16 bits in one pass.
        order = np.argsort(sector.astype(np.min_scalar_type(len(origins) * SECTORS)), kind="stable")
        starts = np.searchsorted(sector[order], np.arange(len(origins) * SECTORS + 1))
        return cls(origins, starts, distance_m[order], slope[order])

    def is_hidden_below(self, position: F64, lidar: I64, starts: I64, from_m: float) -> Bools:
        """(C,) whether something nearer hides what each cluster may have between the ground and its bottom.

        A nearer point hides it if the line of sight through it meets the cluster below its bottom, but no lower than
        half of `from_m`: so the view is shut up to where the cluster begins.

        Args:
            position: (P, 3) x, y and height above the ground, sorted by cluster.
            lidar: (P,) lidar of each point.
            starts: (C,) first point of each cluster; each has one.
            from_m: Height below which a cluster has to begin if it stands on the ground.
        """
        sector, away_m, _ = _seen(position, lidar, self.origins)
        cluster = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(position)))
        # The first point of a cluster in each sector stands for all of them.
        _, looks = np.unique(cluster * len(self.starts) + sector, return_index=True)
        cluster, sector = cluster[looks], sector[looks]
        counts = np.diff(self.starts)[sector]
        ends = np.cumsum(counts)
        look = np.repeat(np.arange(len(looks)), counts)
        nearer = np.arange(len(look)) + np.repeat(self.starts[sector] - ends + counts, counts)
        far_m, lidar_m = away_m[looks][look], self.origins[lidar[looks], 2][look]
        meets_m = lidar_m + self.slope[nearer] * far_m
        bottom_m = np.minimum.reduceat(position[:, 2], starts)[cluster[look]]
        hides = (self.distance_m[nearer] < MAX_NEARER_SHARE * far_m) & (from_m / 2 <= meets_m) & (meets_m <= bottom_m)
        is_hidden = np.bincount(look[hides], minlength=len(looks)) > 0
        hidden, lines = (np.bincount(of, minlength=len(starts)) for of in (cluster[is_hidden], cluster))
        return np.asarray(hidden >= MIN_HIDDEN_SHARE * lines)


def _seen(position: F64, lidar: I64, origins: F64) -> tuple[I64, F64, F64]:
    """Sector, horizontal distance and slope of the line of sight of points (N, 3)."""
    x, y, z = (position[:, axis] - origins[:, axis].take(lidar) for axis in range(3))
    distance_m = np.maximum(np.hypot(x, y), 1e-9)
    sector = ((np.arctan2(y, x) + np.pi) / SECTOR_RAD).astype(np.int64)
    return lidar * SECTORS + sector, distance_m, z / distance_m


CEILING_SHARE = 1.15
"""Maximum height of points, as a share of the tallest class: a cluster that reaches it is too tall for any class."""

SPLIT_SHARES = (0.7,)
"""Shares of the link distance at which clusters that fit no class well are clustered again."""


MAX_GOOD_MISFIT = 1.0
"""Maximum misfit of a cluster that is one object for sure; others are also tried in parts."""


class ClusterDetector:
    """Proposes boxes of the configured classes by clustering, L-shape fitting and size priors.

    Boxes stand on the ground, or where none was found at the rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud
    does not tell front from rear.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        self._fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._settings = config.detect3d.cluster
        limits = np.array([prior.max_size_m for prior in config.classes])
        self._ceiling_m = float(limits[:, 2].max()) * CEILING_SHARE
        self._diagonal_m = float(np.hypot(limits[:, 0], limits[:, 1]).max())

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of all clusters, and of the parts of those that fit no class well."""
        rows = np.arange(len(combined.detection_cloud))
        points, _ = self._fitter.thin(combined, rows, self._settings.clearance_m, self._ceiling_m)
        all_points = points

        @cache
        def sight() -> Sight:  # of no use where nothing hangs
            return Sight.of(all_points.position, all_points.lidar, self._fitter.lidars_above_ground(combined))

        parts, cluster = [], np.full(len(points.position), -1)
        for share in (1.0, *SPLIT_SHARES):
            if len(points.position):
                fitted, points, cluster = self._fitted(points, cluster, sight, share)
                parts += [self._fitter.candidates(combined, one) for one in fitted]
        return Candidates3D._make(np.concatenate(columns) for columns in zip(Candidates3D.empty(), *parts, strict=True))

    def _fitted(
        self, points: ThinnedPoints, before: I64, sight: Callable[[], Sight], share: float
    ) -> tuple[list[Fitted], ThinnedPoints, I64]:
        """Boxes of the clusters at a share of the link distance; and the points of those to try in parts, with these.

        A cluster that did not fall apart gets no second box: `before` (N,) is each point's previous cluster, or -1.
        """
        weighted = points.position.copy()
        weighted[:, 2] *= HEIGHT_WEIGHT
        count, cluster = cluster_points(weighted, share * points.link_distance_m)
        rows = np.argsort(cluster.astype(np.min_scalar_type(count)), kind="stable")
        starts = np.searchsorted(cluster[rows], np.arange(count))
        counts, weights = np.diff(starts, append=len(rows)), np.add.reduceat(points.weights[rows], starts)
        x, y, z = points.position[rows].T
        sides = np.stack([x, y, (x + y) * np.sqrt(0.5), (x - y) * np.sqrt(0.5)])
        extents_m = np.maximum.reduceat(sides, starts, axis=1) - np.minimum.reduceat(sides, starts, axis=1)
        bottom, top = np.minimum.reduceat(z, starts), np.maximum.reduceat(z, starts)
        min_height_m = self._settings.min_height_m
        usable = (weights >= self._settings.min_points) & (top >= min_height_m)
        hangs = usable & (bottom > self._settings.max_bottom_m)
        usable &= ~hangs | (top - bottom >= min_height_m)  # no roof's edge
        hangs &= usable
        if hangs.any():
            places, begins = rows_of(starts, len(rows), hangs)
            hanging = rows.take(places)
            position, lidar = points.position.take(hanging, axis=0), points.lidar.take(hanging)
            usable[hangs] = sight().is_hidden_below(position, lidar, begins, self._settings.max_bottom_m)
        came_from = before.take(rows.take(starts))
        small = usable & ((came_from < 0) | (np.bincount(before + 1).take(came_from + 1) > counts))
        small &= extents_m.max(0) <= self._diagonal_m  # a lower bound of the diameter
        places, begins = rows_of(starts, len(rows), small)
        fitted = [self._fitter.fit(select_rows(points, rows.take(places)), begins)] if len(begins) else []
        again = usable.copy()
        for found in fitted:
            again[small] = (found.boxes.class_ids < 0) | (found.boxes.misfit > MAX_GOOD_MISFIT)
        rows = rows.take(rows_of(starts, len(rows), again)[0])
        return fitted, select_rows(points, rows), cluster.take(rows)
