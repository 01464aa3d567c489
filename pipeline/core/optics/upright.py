"""Quarter turns that make the images of cameras upright which are mounted on their side or upside down.

Networks know upright images only, and objects stand on the ground.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64

MIN_UPRIGHT = 0.5
"""Minimum share of the vertical in the plane of the image: cameras that look further up or down are not turned."""

_SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [-1, -1, -1, -1], [-1, 1, -1, 1]], np.int8)

_X, _Y, _Z = np.eye(3)

TURNS = np.array([[_X, _Y, _Z], [_Y, -_X, _Z], [-_X, -_Y, _Z], [-_Y, _X, _Z]])
"""(4, 3, 3) from the optical frame to that of the image after 0 to 3 counterclockwise quarter turns."""


def quarter_turns(rotations: F64) -> I64:
    """(P,) counterclockwise quarter turns, 0 to 3, after which an image is upright.

    `rotations` (P, 3, 3) lead from the site, where z is up, to the optical frame.
    """
    right, down = rotations[:, 0, 2], rotations[:, 1, 2]
    turns = np.rint(np.arctan2(right, -down) / (np.pi / 2)).astype(np.int64) % 4
    return np.where(np.hypot(right, down) < MIN_UPRIGHT, 0, turns)


def turned(xyxy: F64, quarters: I64, sizes_px: F64) -> F64:
    """Boxes (P, 4) in images that are turned counterclockwise, as by `numpy.rot90`, by quarters (P,) of 0 to 3 turns.

    `sizes_px` (P, 2) are width and height of the image before, in whose pixels left, top, right and bottom are given.
    """
    from_px = np.concatenate([sizes_px, sizes_px], 1)
    order = (np.arange(4) + quarters[:, None]) % 4
    edges, ends = np.take_along_axis(xyxy, order, 1), np.take_along_axis(from_px, order, 1)
    return np.where(_SIGNS[quarters] > 0, edges, ends - edges)
