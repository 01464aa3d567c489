"""Belief: how probable it is that a hypothesis is an object, from what every sensor says and what cameras do not say.

The lidars' score is turned into a probability, because it means something else for each class. A 2D box that is matched
speaks for an object. A camera that has it in view, unhidden, and says nothing speaks against it, as far as it finds
objects of that size at all, which is counted while the run goes on. Where no camera looks, the lidars decide. An object
that cameras place by the ground alone is there, but where? Its covariance says how probably it is where it is reported.
"""

from collections.abc import Mapping

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config
from pipeline.fusion.belief.looks import looks_at
from pipeline.fusion.belief.odds import (
    FITTED,
    at_its_place,
    camera_evidence,
    joined,
    log_odds_before_cameras,
    logit,
    probability,
    reach_of_classes,
)
from pipeline.fusion.belief.recall import RecallCounts

__all__ = ["Believe"]


class Believe:
    """Existence probabilities. Learns how much each camera finds, so frames must come in order."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._is_calibrated = config.detect3d.method != "cluster"
        self._frequencies = np.array([prior.frequency for prior in config.classes])
        self._reach_m = reach_of_classes(config.classes)
        self._recall = RecallCounts([camera.name for camera in rig.cameras], config.fuse.camera_recall)

    def __call__(
        self,
        hypotheses: Hypotheses,
        boxes2d: Mapping[str, Boxes2D],
        views: Mapping[str, CameraSensor],
        combined: CombinedCloud,
    ) -> F64:
        """(N,) float64 in [0, 1), probability that there is an object of the class of each hypothesis where it says.

        Where it says is up to half of the largest side of its class away.

        Args:
            hypotheses: N boxes in the site frame, and their matches with `boxes2d`.
            boxes2d: By camera name; a camera without an entry did not look in this frame.
            views: By camera name, the cameras as they stood when their images were taken.
            combined: The clouds of the frame.
        """
        looks = looks_at(hypotheses, boxes2d, views, combined)
        before = self._before_cameras(hypotheses)
        evidence = camera_evidence(looks, self._recall.plain(looks), FITTED)
        self._recall.learn(looks, before, evidence, FITTED)
        boxes = hypotheses.boxes
        place = at_its_place(boxes.covariances, self._reach_m[boxes.class_ids])
        return probability(before + joined(evidence, FITTED)) * place

    def _before_cameras(self, hypotheses: Hypotheses) -> F64:
        boxes = hypotheses.boxes
        scores, is_lidar = boxes.scores.astype(np.float64), np.arange(len(boxes)) < hypotheses.lidar_count
        frequencies = self._frequencies[boxes.class_ids]
        before = log_odds_before_cameras(scores, frequencies, boxes.point_counts, boxes.sources, is_lidar, FITTED)
        return np.where(is_lidar, logit(scores), before) if self._is_calibrated else before
