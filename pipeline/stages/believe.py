"""Belief: the probability that a hypothesis is an object, from the evidence of all sensors.

The lidars' score is turned into a probability, because it means something else for each class. A matched 2D box speaks
for an object. A camera that has it in view, unhidden, without a 2D box speaks against it, as far as it finds objects of
that size at all, which is counted during the run. Where no camera has an image, its evidence of a moment ago counts,
less and less; without any, the lidars decide. For an object that cameras place by the ground alone, the probability
that it is where it is reported counts, too: its covariance gives it.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.detections import Hypotheses
from lidcam.pipeline.core.frame import SensorBundle, own_motion
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.belief.memory import Memory, RecallCounts
from lidcam.pipeline.fusion.belief.odds import (
    FITTED,
    at_its_place,
    camera_evidence,
    joined,
    log_odds_before_cameras,
    probability,
    reach_of_classes,
    shown,
)
from lidcam.pipeline.fusion.belief.visibility import Visibility


class Believe:
    """Existence probabilities. Learns how much each camera finds, and remembers, so frames must come in order.

    Scores of the lidars' boxes are calibrated, unless they are probabilities already (`Engine3D`). Those of
    lidcam's own networks count less where a camera looks.
    """

    def __init__(
        self,
        rig: Rig,
        config: FuseConfig,
        classes: Sequence[ClassPrior],
        motion: MotionConfig,
        *,
        scores_are_probabilities: bool,
        has_network: bool = False,
    ) -> None:
        self._is_calibrated, self._has_network = scores_are_probabilities, has_network
        self._frequencies = np.array([prior.frequency for prior in classes])
        self._reach_m = reach_of_classes(classes)
        self._cameras = [camera.name for camera in rig.cameras]
        self._recall = RecallCounts(self._cameras, config.camera_recall)
        self._memory, self._last_ns = Memory(classes), 0
        self._site_frame, self._motion = rig.site_frame, motion

    def __call__(
        self,
        hypotheses: Hypotheses,
        visibility: Visibility,
        bundle: SensorBundle,
    ) -> F64:
        """(N,) float64 in [0, 1), probability that there is an object of the class of each hypothesis where it says.

        Where it says is up to half of the largest side of its class away.

        Args:
            hypotheses: N boxes in the site frame, and their matches.
            visibility: How the cameras see them.
            bundle: Its time, and the motion of the site frame.

        Raises:
            FrameError: the motion is that of a frame other than the site frame.
        """
        is_seen, has_absent = self._looking(hypotheses, visibility)
        before = self._before_cameras(hypotheses, shown(visibility) & self._has_network)
        evidence = camera_evidence(visibility, self._recall.plain(visibility), FITTED)
        self._recall.learn(visibility, before, evidence, FITTED)
        boxes, said = hypotheses.boxes, joined(evidence, FITTED)
        self._memory.age(
            (bundle.stamp_ns - self._last_ns) / 1e9, own_motion(bundle, self._last_ns, self._site_frame, self._motion)
        )
        self._last_ns = bundle.stamp_ns
        recalled = self._memory.recalled(boxes, ~is_seen & has_absent)
        self._memory.remember(boxes, is_seen, said, all_look=len(visibility.cameras) == len(self._cameras))
        place = at_its_place(boxes.covariances, self._reach_m[boxes.class_ids])
        return probability(before + said + recalled) * place

    def _before_cameras(self, hypotheses: Hypotheses, looked_at: Bools) -> F64:
        boxes = hypotheses.boxes
        scores, is_lidar = boxes.scores.astype(np.float64), np.arange(len(boxes)) < hypotheses.lidar_count
        frequencies = self._frequencies[boxes.class_ids]
        return log_odds_before_cameras(
            scores,
            frequencies,
            boxes.point_counts,
            boxes.sources,
            is_lidar,
            FITTED,
            looked_at=looked_at if self._is_calibrated else None,
        )

    def _looking(self, hypotheses: Hypotheses, visibility: Visibility) -> tuple[Bools, Bools]:
        """(N,) whether a camera looks at each box, and (N,) whether one would that does not look in this frame."""
        nobody = np.zeros((1, len(hypotheses.boxes)), np.bool_)
        absent = [
            np.isfinite(matches.projected_xyxy[:, 0])[None]
            for name, matches in hypotheses.matches.items()
            if name not in visibility.cameras
        ]
        is_seen, has_absent = np.concatenate([nobody, visibility.in_view]), np.concatenate([nobody, *absent])
        return np.asarray(is_seen.any(0)), np.asarray(has_absent.any(0))
