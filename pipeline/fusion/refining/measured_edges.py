"""What the images say of the place of 3D boxes: the edges of the 2D boxes that are matched with them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Rows, select_rows
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.rig import CameraSensor
from pipeline.core.settings.fuse import FuseConfig
from pipeline.fusion.projection import CameraArrays, camera_arrays

__all__ = ["MeasuredEdges", "measured_edges"]

NANOSECONDS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEdges:
    """P pairs of a 3D box and a 2D box, sorted by the 3D box.

    Attributes:
        rows: (P,) int64 row of the 3D box.
        camera_rows: (P,) int64 number of the camera, in the order of the views.
        cameras: P cameras.
        xyxy: (P, 4) float64 left, top, right, bottom of the 2D box, clipped to the image, pixels.
        sigma_px: (P, 4) float64 standard deviation of each edge.
        hidden_px: (P, 4) float64, how far nearer objects may have moved each edge inward.
        later_s: (P,) float64, how much later the image was measured than the 3D box.
    """

    rows: I64
    camera_rows: I64
    cameras: CameraArrays
    xyxy: F64
    sigma_px: F64
    hidden_px: F64
    later_s: F64

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, rows: Rows) -> "MeasuredEdges":
        """The given pairs (mask or indices), in that order."""
        return select_rows(self, rows)


def measured_edges(
    hypotheses: Hypotheses,
    boxes2d: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
    config: FuseConfig,
) -> MeasuredEdges:
    """All matched 2D boxes of a frame.

    An edge errs by some pixels and by a share of the size of the 2D box. Where nearer objects hide a part of the
    object, a detector may see less of it, by as much as they hide of its width or height.

    Args:
        hypotheses: Boxes and their matches.
        boxes2d: By camera name.
        views: The cameras by name.
        config: `pixel_sigma_px` and `outline_sigma`.
    """
    numbered = [(k, name) for k, name in enumerate(views) if name in boxes2d and hypotheses.matches.get(name)]
    matched = [(hypotheses.matches[name], boxes2d[name]) for _, name in numbered]
    counts = [len(matches) for matches, _ in matched]
    rows = np.concatenate([np.zeros(0, np.int64), *(matches.pairs[:, 0] for matches, _ in matched)])
    order = np.argsort(rows, kind="stable")
    rows, numbers = rows[order], np.repeat(np.array([number for number, _ in numbered], np.int64), counts)[order]
    stamps_ns = np.repeat(np.array([found.stamp_ns for _, found in matched], np.int64), counts)[order]
    xyxy = np.concatenate([np.zeros((0, 4)), *(found.xyxy[matches.pairs[:, 1]] for matches, found in matched)])[order]
    hidden = np.concatenate([np.zeros(0), *(matches.hidden[matches.pairs[:, 0]] for matches, _ in matched)])[order]
    cameras = camera_arrays(tuple(views.values())).select(numbers)
    xyxy = xyxy.clip(0.0, cameras.limits)
    extent = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 1.0)
    outline_px = config.outline_sigma * np.sqrt(extent[:, :1] * extent[:, 1:])
    sigma_px = np.repeat(np.hypot(config.pixel_sigma_px, outline_px), 4, axis=1)
    hidden_px = hidden[:, None] * np.concatenate([extent, extent], 1)
    later_s = (stamps_ns - hypotheses.boxes.measured_ns[rows]) * NANOSECONDS
    return MeasuredEdges(rows, numbers, cameras, xyxy, sigma_px, hidden_px, later_s)
