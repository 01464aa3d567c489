"""The engine: one list of boxes of a network in pillars and of clusters, each with what both make of it.

The network finds what clusters join or part, and tells front from rear. Points in a box give its sides more exactly
than the network does, and the learned score of clusters knows people better. So the network's boxes are fitted again to
their points, and the log odds of both are added up with weights (a logarithmic opinion pool; Genest and Zidek,
"Combining probability distributions", 1986).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F32, F64, Indices
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D
from pipeline.core.errors import ModelError
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.geometry.overlaps import OVERLAP_SHARE, overlap_shares
from pipeline.core.geometry.rotated_iou import pair_ious
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.boxes import likely_boxes
from pipeline.detectors.cluster.detector import ClusterDetector
from pipeline.detectors.cluster.fitting import BoxFitter
from pipeline.detectors.cluster.learned import LearnedScores, kinds_of
from pipeline.detectors.cluster.network import KINDS
from pipeline.detectors.cluster.refitting import Refitter
from pipeline.detectors.pillars.detector import PillarDetector
from pipeline.detectors.protocols import Candidates3D

__all__ = ["CombinedDetector"]

SAME_BOX_IOU = 0.25
"""A box that shares less ground with its fit to the points in it keeps its own place and size: what is in it is a part
of the object, or more than it. Of 0.2 to 0.7, about the best for cars, cyclists and people in drawn worlds."""

SCORE_LIMIT = 0.002
"""Scores nearer to 0 or 1 than this count as this."""

PERSON = KINDS.index("pedestrian")


class Weights(NamedTuple):
    """How log odds are added up, for each of `KINDS`.

    Attributes:
        both: (5, 3) sum, factor of the learned score, factor of the network's, where the network has a box.
        alone: (5, 2) sum and factor of the learned score, where the network could have found a box and has none.
    """

    both: F64
    alone: F64


FITTED = Weights(
    both=np.array([[0, 0, 0], [-0.15, 0.30, 0.71], [-0.02, 0.32, 0.89], [0.26, 0.65, 0.67], [1.29, 0.40, 0.56]]),
    alone=np.array([[0, 0], [-2.21, 0.71], [0, 1], [-0.81, 0.84], [-0.70, 1.08]]),
)
"""Fitted by logistic regression to 280 sweeps of 70 drawn roads that neither network was trained on, where people,
cyclists and large vehicles count as often as in streets; crossings give nearly the same. The number of points and the
distance added nothing. In real frames most people and cyclists of a network in pillars are posts and the like, and it
misses more of them. So half of the fit counts for cyclists (all of it: 0.52, 0.29, 1.34 and -1.62, 0.68); and clusters
of people keep their score, and boxes of people have no higher one (the fit of what is alone: -0.50, 1.02)."""


class CombinedDetector:
    """Proposes the boxes of both, with the probability of each by both."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the networks.

        Raises:
            ConfigError: classes are configured that the learned score does not know.
            ModelError: a network is not there or cannot be loaded, or none of its classes is configured.
        """
        if config.detect3d.model is None:
            raise ModelError(
                "detect3d.method combined needs a network: give --model-3d FILE.onnx or set detect3d.model"
            )
        self._learned, self._kinds = LearnedScores(rig, config), kinds_of(config.classes).argmax(1)
        self._clusters, self._network = ClusterDetector(rig, config), PillarDetector(rig, config)
        fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._refit = Refitter(fitter, config.detect3d.cluster, config.classes)
        self._site_frame, self._min_score = rig.site_frame, config.detect3d.min_score

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of the network, fitted to their points, and clusters that have the direction of such a box."""
        clusters = likely_boxes(combined, self._site_frame, self._clusters(combined), self._min_score)
        clusters = self._learned(combined, clusters)
        found = likely_boxes(combined, self._site_frame, self._network(combined), 0.0)
        network = logit(found.scores)
        found = self._fitted(combined, found)
        cluster, partner = self._partners(clusters, found)
        beside, yaws = np.full(len(clusters), np.nan), clusters.yaws.copy()
        is_person = self._kinds[clusters.class_ids[cluster]] == PERSON
        beside[cluster] = np.where(is_person, np.nan, network[partner])
        yaws[cluster] += np.pi * (np.cos(yaws[cluster] - found.yaws[partner]) < 0)
        boxes = found.joined(replace(clusters, yaws=wrap_angle(yaws)))
        learned = np.concatenate([self._learned_of(combined, found), clusters.scores])
        odds = self._log_odds(boxes, logit(learned), np.append(network, beside))
        return Candidates3D(
            boxes.centers,
            boxes.sizes,
            boxes.yaws,
            1 / (1 + np.exp(-odds)),
            boxes.class_ids.astype(np.int64),
            boxes.point_counts.astype(np.int64),
            boxes.covariances,
            boxes.measured_ns - combined.detection_cloud.stamp_ns,
        )

    def _fitted(self, combined: CombinedCloud, found: Boxes3D) -> Boxes3D:
        """The network's boxes (N,), as their points have them as far as these agree."""
        fitted, _ = self._refit(combined, found, np.arange(len(found)))
        agree = pair_ious(found, fitted).bev >= SAME_BOX_IOU
        rows = np.arange(len(found)) + len(found) * agree
        return found.joined(fitted).select(rows)

    def _learned_of(self, combined: CombinedCloud, found: Boxes3D) -> F64:
        """(N,) learned score of boxes of the network as their class."""
        if not len(found):
            return np.zeros(0)
        return np.asarray(self._learned.by_class(combined, found)[np.arange(len(found)), found.class_ids])

    def _partners(self, clusters: Boxes3D, found: Boxes3D) -> tuple[Indices, Indices]:
        """Clusters, and for each the likeliest box of the network of its kind that shares its ground."""
        same = self._kinds[clusters.class_ids][:, None] == self._kinds[found.class_ids]
        rows, columns = np.nonzero(same & (overlap_shares(clusters, found) > OVERLAP_SHARE))
        cluster, first = np.unique(rows, return_index=True)  # likelier ones first
        return cluster, columns[first]

    def _log_odds(self, boxes: Boxes3D, learned: F64, network: F64) -> F64:
        """(N,) of boxes, by the log odds of both; those of the network are NaN where it has no box."""
        kinds = self._kinds[boxes.class_ids]
        both, alone = FITTED.both[kinds], FITTED.alone[kinds]
        missed = alone[:, 0] + alone[:, 1] * learned
        missed = np.where(self._network.reaches(boxes.centers[:, :2]), missed, learned)
        joint = both[:, 0] + both[:, 1] * learned + both[:, 2] * network
        joint = np.where(kinds == PERSON, np.minimum(joint, learned), joint)
        return np.where(np.isnan(network), missed, joint)


def logit(scores: F32 | F64) -> F64:
    """Log odds of probabilities, limited by `SCORE_LIMIT`."""
    limited = scores.astype(np.float64).clip(SCORE_LIMIT, 1 - SCORE_LIMIT)
    return np.asarray(np.log(limited / (1 - limited)))
