"""The engine: boxes of a network in pillars merged with clusters, each rated by both.

The network finds what clusters join or part, and tells front from rear. Points in a box give its sides more exactly
than the network does, and the learned score of clusters knows people better. So the network's boxes are fitted again to
their points, and the log odds of both are added up with weights (a logarithmic opinion pool; Genest and Zidek,
"Combining probability distributions", 1986).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, Indices
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import rotations_2d, wrap_angle
from lidcam.pipeline.core.geometry.overlaps import OVERLAP_SHARE, overlap_shares
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.boxes import likely_boxes
from lidcam.pipeline.detectors.cluster.detector import ClusterDetector
from lidcam.pipeline.detectors.cluster.kinds import KINDS, groups_of, kinds_of, knows
from lidcam.pipeline.detectors.cluster.learned import LearnedScores
from lidcam.pipeline.detectors.log_odds import logit, sigmoid
from lidcam.pipeline.detectors.pillars.detector import FittedPillarDetector
from lidcam.pipeline.detectors.protocols import Candidates3D

UNKNOWN, PERSON, LARGE = map(KINDS.index, ("background", "pedestrian", "large vehicle"))

CLUSTER_BONUS = 0.01
"""Log-odds bonus of a cluster over a co-located network box, for classes without a learned score: the points show the
sides of model cars better than the network does."""


NEAR_M = 6.0
"""Distance of a side from the nearest lidar within which a large vehicle fills the field of view: its top, and often
its ends, are out of sight, and the network doubts it. With `detect3d.near_weight`, fitted as `FITTED`."""


class Weights(NamedTuple):
    """Weights of log odds in the sum, for each of `KINDS`."""

    both: F64  # (5, 3) offset, factor of the clusters' score and factor of the network's, where the network has a box
    alone: F64  # (5, 2) offset and factor of the clusters' score, where the network could have found a box and has none


FITTED = Weights(
    both=np.array([[0, 0, 1], [0.00, 0.19, 0.72], [-0.15, 0.23, 0.94], [0.13, 0.65, 0.59], [0.33, 0.28, 0.81]]),
    alone=np.array([[-1, 1], [-2.63, 0.59], [0, 1], [-0.98, 1.02], [-1.45, 1.02]]),
)
"""The first row is of classes that the learned score does not know. The others are fitted on drawn worlds
(`benchmarks/measured/combined_fit.py`), by halves for cyclists and not for people alone."""


class Evidence(NamedTuple):
    """Log odds of N boxes."""

    boxes: Boxes3D  # The boxes
    learned: F64  # (N,) log odds by the score of clusters; 0 for boxes of the network if that is not the learned one
    network: F64  # (N,) log odds by the network; NaN where it has no box
    is_reached: Bools  # (N,) whether the network knows such objects, and its grid reaches them
    near: F64  # (N,) logarithm of the points, times the share of `NEAR_M` by which a side is nearer


class CombinedDetector:
    """Proposes the boxes of both, with the probability of each by both."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the networks; raises ModelError if one is missing, cannot be loaded, or has none of the classes."""
        is_known = knows(config.classes)
        self._learned = LearnedScores(rig, config) if is_known else None
        self._kinds = kinds_of(config.classes).argmax(1) if is_known else np.zeros(len(config.classes), np.int64)
        # Classes of one kind may stand for each other: a truck of clusters is a bus of the network.
        self._groups = groups_of(config.classes)
        self._clusters, self._fitted = ClusterDetector(rig, config), FittedPillarDetector(rig, config)
        self._network = self._fitted.network
        # Simulated people are more alike than real ones, so a network that saw no others makes none probable.
        self._are_doubted = (self._kinds == PERSON) & ~np.isin(np.arange(len(self._kinds)), self._network.recorded_ids)
        self._site_frame, self._min_score = rig.site_frame, config.detect3d.min_score
        self._near_weight = config.detect3d.near_weight
        self._lidar_xy = rig.lidar_xyz[:, :2]

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of the network, fitted to their points, and clusters that have the direction of such a box."""
        evidence = self.evidence(combined)
        return Candidates3D.of(evidence.boxes, sigmoid(self._log_odds(evidence)), combined)

    def evidence(self, combined: CombinedCloud) -> Evidence:
        """The boxes of a frame, and their log odds by both."""
        clusters = likely_boxes(combined, self._site_frame, self._clusters(combined), self._min_score)
        if self._learned is not None:
            clusters = self._learned(combined, clusters)
        found = self._fitted.boxes(combined)
        network = logit(found.scores.astype(np.float64))
        cluster, partner = self._partners(clusters, found)
        beside, yaws = np.full(len(clusters), np.nan), clusters.yaws.copy()
        class_ids = clusters.class_ids[cluster]
        bonus = CLUSTER_BONUS * (self._kinds[class_ids] == UNKNOWN)
        beside[cluster] = np.where(self._are_doubted[class_ids], np.nan, network[partner] + bonus)
        yaws[cluster] += np.pi * (np.cos(yaws[cluster] - found.yaws[partner]) < 0)
        boxes = found.joined(replace(clusters, yaws=wrap_angle(yaws)))
        own = np.full(len(found), 0.5)
        if self._learned is not None and len(found):
            own = self._learned.existence(combined, found)
        learned = np.concatenate([own, clusters.scores])
        is_found = np.isin(self._groups, self._groups[self._network.class_ids])
        is_reached = is_found[boxes.class_ids] & self._network.reaches(boxes.centers[:, :2])
        in_box = (self._lidar_xy - boxes.centers[:, None, :2]) @ rotations_2d(boxes.yaws)
        outside = np.abs(in_box) - boxes.sizes[:, None, :2] / 2
        side_m = np.linalg.norm(np.maximum(outside, 0.0), axis=2).min(1, initial=NEAR_M)
        near = np.log(np.maximum(boxes.point_counts, 1)) * (1 - side_m / NEAR_M)
        return Evidence(boxes, logit(learned.astype(np.float64)), np.append(network, beside), is_reached, near)

    def _partners(self, clusters: Boxes3D, found: Boxes3D) -> tuple[Indices, Indices]:
        """Clusters, and for each the likeliest box of the network that shares its ground, of its kind.

        Of a class that is of no kind, it is one of its class.
        """
        same = self._groups[clusters.class_ids][:, None] == self._groups[found.class_ids]
        rows, columns = np.nonzero(same & (overlap_shares(clusters, found) > OVERLAP_SHARE))
        cluster, first = np.unique(rows, return_index=True)  # likelier ones first
        return cluster, columns[first]

    def _log_odds(self, evidence: Evidence) -> F64:
        """(N,) of boxes, by the log odds of both."""
        boxes, learned, network, is_reached, near = evidence
        kinds = self._kinds[boxes.class_ids]
        both, alone = FITTED.both[kinds], FITTED.alone[kinds]
        missed = alone[:, 0] + alone[:, 1] * learned
        missed = np.where(is_reached, missed, learned)
        joint = both[:, 0] + both[:, 1] * learned + both[:, 2] * network
        joint = np.where(self._are_doubted[boxes.class_ids], np.minimum(joint, learned), joint)
        joint += self._near_weight * near * (kinds == LARGE)
        return np.where(np.isnan(network), missed, joint)
