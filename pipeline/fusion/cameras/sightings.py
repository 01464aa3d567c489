"""The 2D boxes of all cameras of a frame as one table, with the directions of their edges."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Rows, select_rows
from pipeline.core.camera import BORDER_PX
from pipeline.core.detections import Boxes2D
from pipeline.core.rig import CameraSensor
from pipeline.fusion.cameras.rays import rays_of_pixels
from pipeline.fusion.projection import CameraArrays

__all__ = ["Sightings", "see"]

LEAST_PX = 0.5
"""A box that is narrower or lower shows nothing."""


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
        return replace(select_rows(self, rows), views=self.views.select(rows))


def see(views: Mapping[str, CameraSensor], boxes2d: Mapping[str, Boxes2D]) -> Sightings:
    """The boxes of every camera that has some, but for boxes that leave nothing of themselves in it."""
    names = [name for name in views if name in boxes2d]
    order = [_ranked(boxes2d[name]) for name in names]
    boxes = [boxes2d[name].select(rows) for name, rows in zip(names, order, strict=True)]
    counts = [len(rows) for rows in order]
    owner = np.repeat(np.arange(len(names)), counts)
    cameras = CameraArrays.of([views[name] for name in names]).select(owner)
    size = np.tile(cameras.image_sizes, 2)
    xyxy = np.concatenate([np.zeros((0, 4)), *(some.xyxy for some in boxes)]).clip(0, size)
    rays, sound = rays_of_pixels(cameras.lenses, _outline(xyxy))
    numbers = np.array([number for number, name in enumerate(views) if name in boxes2d], np.int64)
    table = Sightings(
        numbers[owner],
        np.concatenate([np.zeros(0, np.int64), *order]),
        xyxy,
        np.concatenate([xyxy[:, :2] <= BORDER_PX, xyxy[:, 2:] >= size[:, 2:] - BORDER_PX], 1),
        np.concatenate([np.zeros(0), *(some.scores for some in boxes)]),
        np.concatenate([np.zeros(0, np.int64), *(some.class_ids for some in boxes)]),
        np.repeat(np.array([some.stamp_ns for some in boxes], np.int64), counts),
        cameras,
        -(cameras.rotations * cameras.translations[:, :, None]).sum(1),
        (cameras.rotations[:, None] * rays[..., None]).sum(2),
    )
    shown = np.isfinite(xyxy).all(1) & np.asarray(sound.all(1)) & (xyxy[:, 2:] - xyxy[:, :2] >= LEAST_PX).all(1)
    return table.select(np.flatnonzero(shown))


def _outline(xyxy: F64) -> F64:
    """(P, 8, 2) corners and middles of the edges, clockwise from the left top corner."""
    low, high = xyxy[:, :2], xyxy[:, 2:]
    shares = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])
    return np.asarray(low[:, None] + shares * (high - low)[:, None])


def _ranked(boxes: Boxes2D) -> I64:
    return np.lexsort([*boxes.xyxy.T, boxes.class_ids, -boxes.scores]).astype(np.int64)
