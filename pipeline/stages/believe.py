"""Belief: the probability that a hypothesis is an object, from the evidence of all sensors.

The lidars' score is turned into a probability, since its meaning differs between classes. A matched 2D box counts for
an object. A camera that has it in view, unhidden, without a 2D box counts against it, by the camera's recall for
objects of that size, which is counted during the run. Between the images of a camera its latest evidence, and how well
it saw the object, count with falling weight; without any, the lidars decide. The probability that the object is at its
position, by its covariance, counts as well: it is small for objects that cameras place by the ground alone.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, Hypotheses
from lidcam.pipeline.core.frame import SensorBundle, own_motion
from lidcam.pipeline.core.geometry.overlaps import overlap_shares
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.fusion.belief.memory import Memory, RecallCounts
from lidcam.pipeline.fusion.belief.odds import (
    FITTED,
    camera_evidence,
    joined,
    joined_without_each,
    log_odds_before_cameras,
    match_radii_m,
    position_probability,
    probability,
    view_shares,
)
from lidcam.pipeline.fusion.belief.visibility import Visibility

MAX_SHARED_GROUND = 0.5
"""Maximum share of a vehicle's ground that is another's, for both to be there: estimates of neighbours may overlap."""


class Believe:
    """Existence probabilities. Learns the recall of each camera, and remembers, so frames must come in order.

    Scores of the lidars' boxes are calibrated, unless they are probabilities already (`Engine3D`). Those of lidcam's
    own networks count less in view of a camera.
    """

    def __init__(
        self,
        rig: Rig,
        classes: Sequence[ClassPrior],
        motion: MotionConfig,
        *,
        scores_are_probabilities: bool,
        has_network: bool = False,
    ) -> None:
        self._is_calibrated, self._has_network = scores_are_probabilities, has_network
        self._frequencies = np.array([prior.frequency for prior in classes])
        self._are_upright = np.array([prior.is_upright for prior in classes])
        self._radii_m = match_radii_m(classes)
        self._cameras = [camera.name for camera in rig.cameras]
        self._recall = RecallCounts(self._cameras)
        self._memory, self._last_ns = Memory(classes, 3 * len(rig.cameras)), 0  # evidence and `view_shares` of each
        self._site_frame, self._motion = rig.site_frame, motion

    def __call__(self, hypotheses: Hypotheses, visibility: Visibility, bundle: SensorBundle) -> F64:
        """(N,) float64 in [0, 1), probability of an object of the class of each hypothesis at its position.

        "At its position" means within half the longest side of the class.

        Args:
            hypotheses: N boxes in the site frame, and their matches.
            visibility: Their visibility for the cameras.
            bundle: Source of the time and of the motion of the site frame.

        Raises:
            FrameError: the motion is that of a frame other than the site frame.
        """
        recall = self._recall.plain(visibility)
        shares = view_shares(visibility, recall)
        boxes, look = hypotheses.boxes, np.isin(self._cameras, visibility.cameras)
        rows = [self._cameras.index(name) for name in visibility.cameras]
        shape = len(self._cameras), len(boxes)
        found, is_seen = np.zeros((3, *shape)), np.zeros(shape, np.bool_)
        is_seen[rows] = visibility.in_view
        self._memory.advance(
            (bundle.stamp_ns - self._last_ns) / 1e9, own_motion(bundle, self._last_ns, self._site_frame, self._motion)
        )
        self._last_ns = bundle.stamp_ns
        in_image = [np.isfinite(hypotheses.matches[name].projected_xyxy[:, 0]) for name in self._cameras]
        is_asked = ~look[:, None] & np.array(in_image, np.bool_).reshape(shape)
        recalled = self._memory.recalled(boxes, np.tile(is_asked, (3, 1))).reshape(found.shape)
        by_camera = camera_evidence(visibility, recall, FITTED)
        before = self._before_cameras(hypotheses, np.concatenate([shares, recalled[1:]], 1))
        sees = self._recall.learn(visibility, probability(before + joined_without_each(by_camera, FITTED)))
        found[:, rows] = [camera_evidence(visibility, recall * sees, FITTED), *(shares * sees)]
        self._memory.remember(boxes, np.tile(is_seen, (3, 1)), np.concatenate(found), np.tile(look, 3))
        evidence, *seen = found + recalled
        before = self._before_cameras(hypotheses, np.array(seen))
        position = position_probability(boxes.covariances, self._radii_m[boxes.class_ids])
        return self._exclusive(boxes, probability(before + joined(evidence, FITTED)) * position)

    def _exclusive(self, boxes: Boxes3D, beliefs: F64) -> F64:
        """The same, where of vehicles that share most of their ground one is there at most."""
        vehicles = np.flatnonzero(~self._are_upright[boxes.class_ids])
        vehicles = vehicles[np.argsort(-beliefs[vehicles], kind="stable")]
        better, chosen = beliefs[vehicles], boxes.select(vehicles)
        is_rival = np.triu(overlap_shares(chosen, chosen) > MAX_SHARED_GROUND, 1)
        beliefs[vehicles] = np.minimum(better, 1 - (is_rival * better[:, None]).max(0, initial=0.0))
        return beliefs

    def _before_cameras(self, hypotheses: Hypotheses, shares: F64) -> F64:
        """(N,) log odds by the lidars alone; `shares` (2, C, N) are the `view_shares` of cameras."""
        boxes = hypotheses.boxes
        in_view = shares.max(1, initial=0.0) * self._has_network
        return log_odds_before_cameras(
            boxes.scores.astype(np.float64),
            self._frequencies[boxes.class_ids],
            boxes.point_counts,
            boxes.sources,
            np.arange(len(boxes)) < hypotheses.lidar_count,
            FITTED,
            in_view=in_view if self._is_calibrated else None,
            are_upright=self._are_upright[boxes.class_ids],
        )
