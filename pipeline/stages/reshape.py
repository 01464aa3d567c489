"""Boxes completed again with the class by the cameras.

A lidar sees the near sides of an object; its extent behind them depends on its class. Where a camera corrects the
class, the box by the lidars' class is too long or too short, and its heading may be that of the other axis: the far
part of a cyclist taken for a pedestrian, or a van for a car.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Hypotheses
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import Detect3DConfig
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.cluster.refitting import Refitter


class Reshape:
    """Refits boxes whose class is not the one that they were completed with.

    Only boxes from clustering change: networks and recorded detectors know the shapes of objects.
    """

    def __init__(self, fitter: BoxFitter, config: Detect3DConfig, classes: Sequence[ClassPrior]) -> None:
        self._is_on = ENGINES[config.engine].boxes_are_completed
        self._refit = Refitter(fitter, config.cluster, classes)

    def __call__(self, combined: CombinedCloud, hypotheses: Hypotheses, lidar: Boxes3D) -> Hypotheses:
        """The same hypotheses; boxes of another class than by the lidars are fitted again.

        Where that fails, as the points are more than an object of that class has (see `Refitter`), they keep the class
        by the lidars.

        Args:
            combined: The cloud of the boxes.
            hypotheses: The boxes with their class by both sensors.
            lidar: The first rows of the hypotheses, with their class by the lidars.
        """
        boxes = hypotheses.boxes
        rows = np.flatnonzero(boxes.class_ids[: hypotheses.lidar_count] != lidar.class_ids)
        if not self._is_on or not len(rows):
            return hypotheses
        boxes, fitted = self._refit(combined, boxes, rows)
        class_ids, failed = boxes.class_ids.copy(), np.setdiff1d(rows, fitted)
        class_ids[failed] = lidar.class_ids[failed]
        return replace(hypotheses, boxes=replace(boxes, class_ids=class_ids))
