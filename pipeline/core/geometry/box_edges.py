"""The edges of boxes as lines: cut behind the camera, sampled, clipped to an image."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools

BOX_EDGES = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]])
"""The two corners of each edge of a box, in the order of `box_corners`."""

EDGE_SHARES = np.linspace(0.0, 1.0, 5)
"""Samples along the edges of a box that may be outermost: lens distortion bends edges beyond their corners."""


def edge_samples(corners_camera: F64, near_m: float) -> tuple[F64, Bools]:
    """Points (N, 12, S, 3) along the 12 edges of `edges_ahead`, and whether anything is left of the edge of each."""
    start, end, is_ahead = edges_ahead(corners_camera, near_m)
    shares = EDGE_SHARES[:, None]
    samples = start[:, :, None] * (1 - shares) + end[:, :, None] * shares
    return samples, np.repeat(is_ahead[..., None], len(shares), axis=2)


def edges_ahead(corners_camera: F64, near_m: float) -> tuple[F64, F64, Bools]:
    """The 12 edges of boxes, given by corners (N, 8, 3) in the optical frame, cut at the depth `near_m`.

    Returns (N, 12, 3) starts and (N, 12, 3) ends of the edges; (N, 12) whether anything of each is left.
    """
    start, end = corners_camera[:, BOX_EDGES[:, 0]], corners_camera[:, BOX_EDGES[:, 1]]
    z0, z1 = start[..., 2:], end[..., 2:]
    rise = np.where(z0 == z1, 1.0, z1 - z0)
    cut_point = start + np.clip((near_m - z0) / rise, 0.0, 1.0) * (end - start)
    left = np.maximum(z0, z1)[..., 0] >= near_m
    return np.where(z0 < near_m, cut_point, start), np.where(z1 < near_m, cut_point, end), left


def sample_by_angle(start: F64, end: F64, count: int) -> F64:
    """(..., count, 3) points on lines, evenly spaced in the angle under which the origin sees them, both ends included.

    So a line that passes close by the camera has its samples where the image shows it. Its ends (..., 3) are metres
    from the origin, and not the origin itself.
    """
    r0, r1 = np.sqrt((start * start).sum(-1)), np.sqrt((end * end).sum(-1))
    cosine = (start * end).sum(-1) / (r0 * r1)
    angle = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))[..., None]
    even = np.linspace(0.0, 1.0, count)
    near, far = r0[..., None] * np.sin(even * angle), r1[..., None] * np.sin((1 - even) * angle)
    whole = near + far
    radial = angle < 1e-6  # seen end-on: any spacing will do
    share = np.where(radial, even, near / np.where(radial | (whole == 0), 1.0, whole))[..., None]
    return np.asarray(start[..., None, :] * (1 - share) + end[..., None, :] * share)


def clip_segments(segments: F64, limits: F64) -> tuple[F64, Bools]:
    """Segments clipped to rectangles from (0, 0) to their widths and heights, `limits` (2,) of all or (N, 2) of each.

    After Liang and Barsky, "A new concept and method for line clipping", ACM TOG 3(1), 1984. Returns (N, 2, 2) the
    parts inside, both ends, x and y; (N,) whether there is one, else the row is meaningless.
    """
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    moves = way != 0
    pace = np.where(moves, way, 1.0)
    first, second = -start / pace, (limits - start) / pace
    enter = np.where(moves, np.minimum(first, second), -np.inf).max(-1)
    leave = np.where(moves, np.maximum(first, second), np.inf).min(-1)
    enter, leave = np.maximum(enter, 0.0), np.minimum(leave, 1.0)
    beside = (~moves & ((start < 0) | (start > limits))).any(-1)
    clipped = start[:, None] + np.stack([enter, leave], -1)[..., None] * way[:, None]
    return np.clip(clipped, 0.0, limits[..., None, :]), (enter < leave) & ~beside & moves.any(-1)
