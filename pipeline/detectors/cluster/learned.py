"""Class and probability of clusters by what their points look like, learned from simulated worlds."""

from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.features import REACH_M, box_features
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.cluster.kinds import KINDS, kinds_of
from lidcam.pipeline.detectors.cluster.network import EMBEDDED, ClusterNetwork
from lidcam.pipeline.detectors.cluster.refitting import Refitter

CAR, LARGE = map(KINDS.index, ("car", "large vehicle"))

MIN_PROBABILITY = 0.15
"""Minimum probability of a box's new class; one below it is most probably no object, and keeps its own class."""


class FeatureFinder:
    """Finds the features of the boxes of a frame."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Raises ConfigError: see `kinds_of`."""
        self.members = kinds_of(config.classes)
        self._fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._lidar_xy = rig.lidar_xyz[:, :2]

    def __call__(self, combined: CombinedCloud, boxes: Boxes3D) -> F64:
        """(B, F) of `FEATURES`, for B boxes that were found by clustering in that cloud, at least one."""
        rows, box = points_in_footprints(
            combined.detection_cloud.xyz, boxes.centers[:, :2], boxes.sizes[:, :2] + 2 * REACH_M, boxes.yaws
        )
        above = self._fitter.above_ground(combined, rows, -np.inf)
        starts = np.searchsorted(box[above.place], np.arange(len(boxes) + 1))
        kinds: I64 = self.members.argmax(1)[boxes.class_ids]
        return box_features(boxes, kinds, above.position, starts, self._lidar_xy)


class LearnedScores:
    """Gives boxes that were found by clustering the class that they look like, and its probability as score."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Read `detect3d.weights`; raises ModelError if it cannot be read, and ConfigError as `kinds_of`."""
        self._features = FeatureFinder(rig, config)
        self._network = ClusterNetwork.read(config.detect3d.weights or EMBEDDED)
        fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._refit = Refitter(fitter, config.detect3d.cluster, config.classes)

    def existence(self, combined: CombinedCloud, boxes: Boxes3D) -> F64:
        """(B,) probability that the object of each box is there, for B boxes, at least one, of whatever engine.

        Tall cars may look like vans: for a car, both count.
        """
        either = self._features.members.copy()
        either[:, LARGE] |= either[:, CAR]
        by_kind = self._network(self._features(combined, boxes))
        return np.asarray((by_kind @ either.T)[np.arange(len(boxes)), boxes.class_ids])

    def __call__(self, combined: CombinedCloud, boxes: Boxes3D) -> Boxes3D:
        """Boxes in their order, with new classes and scores; where the class changes, completed anew if that fits."""
        if not len(boxes):
            return boxes
        by_class = self._network(self._features(combined, boxes)) @ self._features.members.T
        rows, own = np.arange(len(boxes)), boxes.class_ids
        likely = np.where(by_class > by_class[rows, own][:, None], by_class, 0.0)
        changed = np.flatnonzero(likely.max(1) >= MIN_PROBABILITY)
        class_ids = own.copy()
        class_ids[changed] = likely[changed].argmax(1)
        fitted, kept = self._refit(combined, replace(boxes, class_ids=class_ids), changed)
        final = own.copy()
        final[kept] = class_ids[kept]
        return replace(fitted, class_ids=final, scores=by_class[rows, final].astype(np.float32))
