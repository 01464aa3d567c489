"""The engine: boxes of a network in pillars, fitted to the points in them.

The network knows where objects are and where their front is; the points in a box give its sides more exactly.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.rotated_iou import pair_ious
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.boxes import likely_boxes
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.cluster.refitting import Refitter
from lidcam.pipeline.detectors.pillars.detector import PillarDetector
from lidcam.pipeline.detectors.protocols import Candidates3D

MIN_FITTED_IOU = 0.25
"""Minimum IoU, seen from above, of a box and the one fitted to its points, for the fit to be taken. Of 0.2 to 0.7 about
the best in drawn worlds."""

MAX_FITTED_TURN_SIGMAS = 1.5
"""Maximum turn of a fitted box, in the network's standard deviations of the heading. Of 1 to 2.5 (22 to 56 degrees for
cars, 38 to 95 for cyclists) about the best in drawn worlds."""


class FittedPillarDetector:
    """Proposes the boxes of a network, moved to fit the points in them."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the network.

        Raises:
            ModelError: there is none, it cannot be loaded, or none of its classes is configured.
        """
        self._network, self._site_frame = PillarDetector(rig, config), rig.site_frame
        fitter = BoxFitter(rig, config.classes, config.detect3d.cluster)
        self._refit = Refitter(fitter, config.detect3d.cluster, config.classes)

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of the network, fitted to their points where the fit agrees with the network."""
        boxes = self.boxes(combined)
        return Candidates3D.of(boxes, boxes.scores.astype(np.float64), combined)

    def boxes(self, combined: CombinedCloud) -> Boxes3D:
        """Boxes as proposed, likelier ones first, without those that share the ground of a likelier one.

        A box is left as it is where its points are only a part of the object, or more than the object.
        """
        found = likely_boxes(combined, self._site_frame, self._network(combined), 0.0)
        fitted, _ = self._refit(combined, found, np.arange(len(found)))
        turn = np.abs(wrap_angle(2 * (fitted.yaws - found.yaws))) / 2  # the network decides front and rear
        agree = (pair_ious(found, fitted).bev >= MIN_FITTED_IOU) & (
            turn <= MAX_FITTED_TURN_SIGMAS * np.sqrt(found.covariances[:, 2, 2])
        )
        return found.joined(fitted).select(np.arange(len(found)) + len(found) * agree)

    @property
    def class_ids(self) -> I64:
        """(M,) classes that the network finds."""
        return self._network.class_ids

    def reaches(self, xy: F64) -> Bools:
        """(N,) whether places (N, 2) in the site frame are in the grid of the network."""
        return self._network.reaches(xy)
