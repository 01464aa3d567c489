"""Recorded 3D boxes of all detectors as the boxes of a frame."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.detections import Boxes3D
from pipeline.core.frame import SensorBundle
from pipeline.core.geometry.overlaps import without_overlaps
from pipeline.core.geometry.rotated_iou import BoxArrays
from pipeline.core.rig import Rig

__all__ = ["Recorded3D"]


class Recorded3D:
    """The boxes of all recorded detectors together.

    Of two boxes of different detectors that stand on the same ground only the better one is kept; what one detector
    says next to itself is left as it is.
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
        kept = without_overlaps(BoxArrays(ordered.centers, ordered.sizes, ordered.yaws), groups[order])
        return ordered.select(kept)
