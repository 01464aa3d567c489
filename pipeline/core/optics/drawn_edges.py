"""The edges of boxes as they lie in images: bent by the lens, cut behind the camera and at the border."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, Indices
from lidcam.pipeline.core.camera import NEAR_M, CameraModel
from lidcam.pipeline.core.geometry.box_edges import clip_segments, edges_ahead, sample_by_angle
from lidcam.pipeline.core.optics.lenses import Lenses

SAMPLES = 25
"""Points by which a bent edge is drawn."""

MAX_BEND_PX = 0.5
"""Largest bend of an edge that is drawn by its ends alone."""


def draw_edges(models: Sequence[CameraModel], corners_camera: F64, cameras: Indices) -> tuple[F32, Indices]:
    """The edges of boxes, each in the image of one of the `cameras` (N,), rows of `models`.

    Boxes have corners (N, 8, 3) in the order of `geometry.box_corners`, metres in the optical frame. Returns (M, 2, 2)
    straight pieces, both ends in pixels, box after box; (M,) row of the box of each piece.
    """
    start, end, in_front = edges_ahead(corners_camera, NEAR_M)
    boxes, _ = np.nonzero(in_front)
    samples = sample_by_angle(start[in_front], end[in_front], SAMPLES)
    pixels, valid = Lenses.of(models).select(cameras[boxes]).project(samples)
    straight = valid.all(1) & (_bend(pixels) < MAX_BEND_PX)
    pieces = np.stack([pixels[:, :-1], pixels[:, 1:]], 2)
    pieces[straight, 0, 1] = pixels[straight, -1]
    wanted = valid[:, :-1] & valid[:, 1:]
    wanted[straight, 1:] = False
    of_edge, _ = np.nonzero(wanted)
    sizes = np.array([[model.width_px, model.height_px] for model in models], np.float64).reshape(-1, 2)
    clipped, inside = clip_segments(pieces[wanted], sizes[cameras[boxes[of_edge]]])
    return clipped[inside].astype(np.float32), boxes[of_edge[inside]]


def _bend(pixels: F64) -> F64:
    """(N,) how far lines (N, S, 2) leave the straight way between their ends, pixels."""
    way, reach = pixels[:, -1:] - pixels[:, :1], pixels - pixels[:, :1]
    aside = np.abs(way[..., 0] * reach[..., 1] - way[..., 1] * reach[..., 0])
    return np.asarray((aside / np.maximum(np.sqrt((way * way).sum(-1)), 1e-9)).max(1))
