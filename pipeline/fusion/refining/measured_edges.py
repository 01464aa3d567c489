"""What the images say of the place of 3D boxes: the edges of the 2D boxes that are matched with them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import F64, I64, Array, Rows, check_array
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.rig import CameraSensor
from pipeline.core.settings.fuse import FuseConfig
from pipeline.fusion.projection import CameraArrays

__all__ = ["MeasuredEdges", "measured_edges"]

NANOSECONDS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEdges:
    """P pairs of a 3D box and a 2D box, sorted by the 3D box.

    Attributes:
        rows: (P,) int64 row of the 3D box.
        camera_rows: (P,) int64 row of the camera.
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
        return MeasuredEdges(
            self.rows[rows],
            self.camera_rows[rows],
            self.cameras.select(rows),
            self.xyxy[rows],
            self.sigma_px[rows],
            self.hidden_px[rows],
            self.later_s[rows],
        )

    def with_more_noise(self, more_px: F64) -> "MeasuredEdges":
        """The same with further standard deviations (P, 4), independent of those at hand."""
        return replace(self, sigma_px=np.sqrt(self.sigma_px**2 + more_px**2))


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
    pairs = [hypotheses.matches[name].pairs for name in names]
    rows = np.concatenate([np.zeros(0, np.int64), *(pair[:, 0] for pair in pairs)])
    camera_rows = np.repeat(np.arange(len(names)), [len(pair) for pair in pairs])
    order = np.argsort(rows, kind="stable")
    rows, camera_rows = rows[order], camera_rows[order]

    def gathered(columns: Sequence[Array], width: int) -> F64:
        return np.concatenate([np.zeros((0, width)), *columns])[order]

    cameras = CameraArrays.of([views[name] for name in names]).select(camera_rows)
    found = gathered([boxes2d[name].xyxy[pair[:, 1]] for name, pair in zip(names, pairs, strict=True)], 4)
    hidden = gathered(
        [hypotheses.matches[name].hidden[pair[:, 0], None] for name, pair in zip(names, pairs, strict=True)], 1
    )
    limits = np.tile(cameras.image_sizes, 2)
    xyxy = np.clip(found, 0.0, limits)
    extent = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 1.0)
    outline_px = config.outline_sigma * np.sqrt(extent.prod(1, keepdims=True))
    sigma_px = np.tile(np.hypot(config.pixel_sigma_px, outline_px), 4)
    stamps_ns = np.array([boxes2d[name].stamp_ns for name in names], np.int64)[camera_rows]
    later_s = (stamps_ns - hypotheses.boxes.measured_ns[rows]) * NANOSECONDS
    return MeasuredEdges(
        rows, camera_rows.astype(np.int64), cameras, xyxy, sigma_px, hidden * np.tile(extent, 2), later_s
    )
