"""Criteria: when a detection counts as right."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Bools
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.near_objects import NEAR_M, Candidates, Measure
from lidcam.pipeline.evaluation.scales import length_scales
from lidcam.pipeline.evaluation.vans import Vans

DISTANCES_M = (0.5, 1.0, 2.0, NEAR_M)
"""Distances of the centres below which a detection counts as right (Caesar et al., nuScenes, CVPR 2020, 3.1)."""

_POSITION = DISTANCES_M.index(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Criterion:
    """When a detection counts as right."""

    # IoU seen from above or in 3D, which must reach the limit, or distance of the centres seen from above, which must
    # stay below it
    measure: Measure
    limits: F64  # (C,) float64 by class: IoU, or metres

    def holds(self, pairs: Candidates, class_ids: I32) -> Bools:
        """(P,) whether it holds for pairs, with the limits of the given classes (P,)."""
        if self.measure == "distance":
            return pairs.distances_m < self.limits[class_ids]
        return (pairs.bev if self.measure == "bev" else pairs.volume) >= self.limits[class_ids]


@dataclass(frozen=True, slots=True, eq=False)
class Criteria:
    """All criteria of a run, and which column of the matches belongs to which."""

    ious: tuple[float, ...]  # IoUs that have a criterion each seen from above and in 3D
    scales: F64  # (C,) float64 by class, factor of all distances
    vans: Vans  # Which true objects may be of two classes

    @classmethod
    def of(cls, config: Config) -> "Criteria":
        """The criteria that the settings ask for."""
        return cls(tuple(dict.fromkeys(config.evaluate.iou)), length_scales(config), Vans(config))

    @property
    def by_overlap(self) -> tuple[Criterion, ...]:
        """First all IoUs seen from above, then all in 3D."""
        measures: tuple[Measure, ...] = ("bev", "volume")
        return tuple(Criterion(m, np.full(len(self.scales), iou)) for m in measures for iou in self.ious)

    @property
    def by_distance(self) -> tuple[Criterion, ...]:
        """One for each of `DISTANCES_M`."""
        return tuple(Criterion("distance", limit_m * self.scales) for limit_m in DISTANCES_M)

    @property
    def position(self) -> Criterion:
        """The criterion of precision, recall and errors: 2 m, scaled."""
        return self.by_distance[_POSITION]

    def bev_column(self, iou: float) -> int:
        """Column of the matches at an IoU seen from above."""
        return self.ious.index(iou)

    def volume_column(self, iou: float) -> int:
        """Column of the matches at an IoU in 3D."""
        return len(self.ious) + self.ious.index(iou)

    @property
    def position_column(self) -> int:
        """Column of the matches by `position`, whose errors are kept."""
        return 2 * len(self.ious) + _POSITION

    @property
    def distance_columns(self) -> range:
        """Columns of the matches from which figures by distance are made, for each of `DISTANCES_M`."""
        return range(2 * len(self.ious), 2 * len(self.ious) + len(DISTANCES_M))
