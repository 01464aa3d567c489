"""The 2D boxes of all cameras of a frame as one table, with the directions of their edges."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Rows, select_rows
from pipeline.core.camera import BORDER_PX
from pipeline.core.detections import Boxes2D
from pipeline.core.rig import CameraSensor
from pipeline.fusion.cameras.rays import rays_of_pixels
from pipeline.fusion.found import FoundBoxes
from pipeline.fusion.projection import CameraArrays, camera_arrays

__all__ = ["Sightings", "see"]

LEAST_PX = 0.5
"""A box that is narrower or lower shows nothing."""

_AROUND = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])


@dataclass(frozen=True, eq=False)
class Sightings:
    """P 2D boxes, camera after camera, and in each by falling score, then by class and place.

    Attributes:
        cameras: (P,) int64 number of the camera, in the order of the views.
        rows: (P,) int64 row of `Boxes2D` of that camera.
        xyxy: (P, 4) float64 left, top, right, bottom in pixels, clipped to the image.
        cut: (P, 4) whether each of these edges lies at the border of the image.
        scores: (P,) float64 in [0, 1].
        class_ids: (P,) int64.
        stamps_ns: (P,) int64 time of the image.
        views: Of the P boxes' cameras.
        origin: (P, 3) float64 the camera, metres in the site frame.
        rays: (P, 8, 3) float64 directions of the corners and the middles of the edges, clockwise from the left top
            corner, in the site frame; of depth 1.
    """

    cameras: I64
    rows: I64
    xyxy: F64
    cut: Bools
    scores: F64
    class_ids: I64
    stamps_ns: I64
    views: CameraArrays
    origin: F64
    rays: F64

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, rows: Rows) -> "Sightings":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)


def see(views: Mapping[str, CameraSensor], boxes2d: Mapping[str, Boxes2D]) -> Sightings:
    """The boxes of every camera that has some, but for boxes that leave nothing of themselves in it."""
    found = FoundBoxes.of(boxes2d, tuple(views))
    rig = camera_arrays(tuple(views.values()))
    cameras = rig.select(found.cameras)
    limits = cameras.limits
    xyxy = found.xyxy.astype(np.float64).clip(0, limits)
    rays, sound = rays_of_pixels(cameras.lenses, _outline(xyxy))
    table = Sightings(
        found.cameras,
        found.rows,
        xyxy,
        np.concatenate([xyxy[:, :2] <= BORDER_PX, xyxy[:, 2:] >= limits[:, 2:] - BORDER_PX], 1),
        found.scores.astype(np.float64),
        found.class_ids.astype(np.int64),
        found.stamps_ns,
        cameras,
        rig.positions[found.cameras],
        (cameras.rotations[:, None] * rays[..., None]).sum(2),
    )
    shown = np.isfinite(xyxy).all(1) & np.asarray(sound.all(1)) & (xyxy[:, 2:] - xyxy[:, :2] >= LEAST_PX).all(1)
    return table if shown.all() else table.select(np.flatnonzero(shown))


def _outline(xyxy: F64) -> F64:
    """(P, 8, 2) corners and middles of the edges, clockwise from the left top corner."""
    low, high = xyxy[:, :2], xyxy[:, 2:]
    return np.asarray(low[:, None] + _AROUND * (high - low)[:, None])
