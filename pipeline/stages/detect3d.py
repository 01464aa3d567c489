"""The 3D boxes of a frame: by an engine in the combined cloud, or as detectors recorded them."""

from collections.abc import Mapping
from importlib import import_module

import numpy as np

from lidcam.pipeline.core.arrays import F32, Indices
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.overlaps import without_overlaps
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.detectors.boxes import likely_boxes
from lidcam.pipeline.detectors.cluster.learned import LearnedScores
from lidcam.pipeline.detectors.protocols import Candidates3D, Detector3D

MIN_SCORE_OF_PEOPLE = 0.005
"""Minimum score of people, on foot or riding, where there are 2D boxes."""

MAX_LIDAR_ABOVE = 0.5
"""Maximum height of a lidar above the box of the vehicle that carries it, in heights of the box."""


class Detect3D:
    """Boxes of the configured classes in the combined cloud, without the vehicle that carries the lidars."""

    def __init__(
        self, rig: Rig, config: Config, *, has_2d_boxes: bool = False, detector: Detector3D | None = None
    ) -> None:
        """Load the engine named by `detect3d.method`, unless one is given, and the network that scores its boxes.

        With 2D boxes, improbable people of a network are kept: the cameras tell which are right. Raises ConfigError if
        the classes are not those that a learned score knows, and ModelError if a network or weights cannot be read.
        """
        self._site_frame = rig.site_frame
        self._lidar_origins_site = rig.lidar_xyz.astype(np.float32)
        min_score = config.detect3d.min_score
        min_people = min(min_score, MIN_SCORE_OF_PEOPLE) if has_2d_boxes and config.detect3d.has_network else min_score
        self._min_scores = np.array([min_people if prior.is_upright else min_score for prior in config.classes])
        self._detector = detector or _detector(rig, config)
        self._rescored = LearnedScores(rig, config) if config.detect3d.is_learned else None

    def __call__(self, combined: CombinedCloud) -> Boxes3D:
        """Boxes in the site frame, in order of falling score, then of x and y."""
        boxes = likely_boxes(combined, self._site_frame, self._detector(combined), self._min_scores)
        boxes = boxes.select(_others(boxes, self._lidar_origins_site))
        if self._rescored is None:
            return boxes
        boxes = self._rescored(combined, boxes)
        return boxes.select(np.lexsort((boxes.centers[:, 1], boxes.centers[:, 0], -boxes.scores)))


def _others(boxes: Boxes3D, lidar_origins_site: F32) -> Indices:
    """Rows of the boxes that are not the vehicle with the lidars: none of these is in the box or close above it."""
    lidars, rows = points_in_footprints(lidar_origins_site, boxes.centers[:, :2], boxes.sizes[:, :2], boxes.yaws)
    above_m = lidar_origins_site[lidars, 2] - boxes.centers[rows, 2] - boxes.sizes[rows, 2] / 2
    own = rows[above_m < MAX_LIDAR_ABOVE * boxes.sizes[rows, 2]]
    return np.setdiff1d(np.arange(len(boxes)), own)


class Recorded3D:
    """The boxes of all recorded detectors together.

    Of two boxes of different detectors on the same ground, only the one with the higher score is kept.
    """

    def __init__(self, rig: Rig) -> None:
        self._site_frame = rig.site_frame
        self._names = [detector.name for detector in rig.detectors]

    def __call__(self, bundle: SensorBundle, found: Mapping[str, Boxes3D]) -> Boxes3D:
        """Boxes in the site frame at the frame's time, in order of falling score, then of x, y and detector.

        Args:
            bundle: Source of the frame's time.
            found: Boxes at that time by name of the detector; detectors may be missing.
        """
        parts = [found[name] for name in self._names if name in found]
        boxes = Boxes3D.empty(bundle.stamp_ns, self._site_frame).joined(*parts)
        groups = np.repeat(np.arange(len(parts)), [len(part) for part in parts]).astype(np.intp)
        order = np.lexsort((groups, boxes.centers[:, 1], boxes.centers[:, 0], -boxes.scores))
        ordered = boxes.select(order)
        return ordered.select(without_overlaps(ordered, groups[order]))


def _detector(rig: Rig, config: Config) -> Detector3D:
    engine = ENGINES[config.detect3d.engine]
    if not engine.maker:
        return lambda _: Candidates3D.empty()
    module, _, name = engine.maker.partition(":")
    detector: Detector3D = getattr(import_module(module), name)(rig, config)
    return detector
