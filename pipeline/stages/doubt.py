"""Headings of improbable vehicles of few points, which may be wrong altogether, and their centres with them.

A fit to a dozen points may follow the wrong side of a car, or take points of a wall for one. Its covariance knows only
the scatter of the points, so one such box would turn and move a track for a second.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.detections import Hypotheses, Source
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import Detect3DConfig

WRONG_HEADING_SHARE = 0.2
"""Share of the least probable vehicles whose heading is wrong: the likeliest on KITTI, Argoverse and in simulation.

Measured: headings of cars with scores below .5 err by 28, 17 and 19 degrees (root mean square) with up to 15, 30 and 60
points, on KITTI and Argoverse, and those with scores above .95 and more than 60 points by 3; their fits claimed 3 to 6.
It is alike in simulation, where trucks with more than 60 points err by 1 degree, whatever their score.
"""

FEW_POINTS = 20
"""Number of points up to which `WRONG_HEADING_SHARE` holds; beyond, it falls with the square of the number."""

ANY_HEADING_VARIANCE = np.pi**2 / 12
"""Variance of an axis of which nothing is known, rad^2."""


class DoubtHeadings:
    """Adds the variances of wrong headings to boxes that lidcam fits, whose scores are probabilities."""

    def __init__(self, config: Detect3DConfig, classes: Sequence[ClassPrior]) -> None:
        is_on = config.has_network or config.is_learned
        # The fit of people allows for a heading across already.
        self._is_doubted = np.array([is_on and not prior.is_upright for prior in classes])

    def __call__(self, hypotheses: Hypotheses) -> Hypotheses:
        """The same hypotheses, with larger variances of heading and position.

        Cameras come before: they measure the heading little, and a wide prior would let them turn boxes that are right.
        """
        boxes = hypotheses.boxes
        covariances, is_lidar = boxes.covariances.copy(), boxes.sources != Source.CAMERA.value
        is_doubted = self._is_doubted[boxes.class_ids] & is_lidar & (covariances[:, 2, 2] > 0)
        wrong = WRONG_HEADING_SHARE * (1 - boxes.scores) * np.minimum(1, FEW_POINTS / boxes.point_counts.clip(1)) ** 2
        covariances[:, 2, 2] += is_doubted * wrong * ANY_HEADING_VARIANCE
        # If the visible side stays, the centre of a turned box is off by half the difference of length and width; each
        # axis has half of the square.
        centre = (boxes.sizes[:, 0] - boxes.sizes[:, 1]) ** 2 / 8
        covariances[:, [0, 1], [0, 1]] += (is_doubted * wrong * centre)[:, None]
        return replace(hypotheses, boxes=replace(boxes, covariances=covariances))
