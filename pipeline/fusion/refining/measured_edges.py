"""What the images say of the place of 3D boxes: the edges of the 2D boxes that are matched with them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Rows, check_array, select_rows
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

    def __post_init__(self) -> None:
        n = len(self.rows)
        check_array("rows", self.rows, (n,), np.int64)
        check_array("camera_rows", self.camera_rows, (n,), np.int64)
        check_array("xyxy", self.xyxy, (n, 4), np.float64)
        check_array("sigma_px", self.sigma_px, (n, 4), np.float64)
        check_array("hidden_px", self.hidden_px, (n, 4), np.float64)
        check_array("later_s", self.later_s, (n,), np.float64)

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
    names = [name for name in views if name in boxes2d and name in hypotheses.matches]
    numbers = np.array([number for number, name in enumerate(views) if name in names], np.int64)
    matches, found = [hypotheses.matches[name] for name in names], [boxes2d[name] for name in names]
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(one.pairs for one in matches)])
    of_camera = np.repeat(np.arange(len(names)), [len(one) for one in matches])
    order = np.argsort(pairs[:, 0], kind="stable")
    of_camera, (rows, rows2d) = of_camera[order], pairs[order].T.copy()
    first = np.cumsum([0, *map(len, found)])[of_camera]
    cameras = camera_arrays(tuple(views.values())).select(numbers[of_camera])
    xyxy = np.concatenate([np.zeros((0, 4)), *(one.xyxy for one in found)])[first + rows2d]
    hidden = np.concatenate([np.zeros(0), *(one.hidden for one in matches)])[of_camera * len(hypotheses.boxes) + rows]
    xyxy = xyxy.clip(0.0, cameras.limits)
    extent = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 1.0)
    outline_px = config.outline_sigma * np.sqrt(extent[:, :1] * extent[:, 1:])
    sigma_px = np.repeat(np.hypot(config.pixel_sigma_px, outline_px), 4, axis=1)
    hidden_px = hidden[:, None] * np.concatenate([extent, extent], 1)
    stamps_ns = np.array([one.stamp_ns for one in found], np.int64)[of_camera]
    later_s = (stamps_ns - hypotheses.boxes.measured_ns[rows]) * NANOSECONDS
    return MeasuredEdges(rows, numbers[of_camera], cameras, xyxy, sigma_px, hidden_px, later_s)
