"""Detection in the combined cloud: from an engine's proposals to the boxes of a frame."""

import numpy as np

from pipeline.core.arrays import F64, Bools, Indices
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import rotations_2d, wrap_angle
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster.detector import ClusterDetector
from pipeline.detectors.protocols import Candidates3D, Detector3D

__all__ = ["Detect3D"]


OVERLAP_SHARE = 0.25
"""If one of two boxes has more than this share of its ground inside the other, only the better one is kept."""

BLOCK, PAIRS = 256, 1 << 14
"""Boxes, and pairs of boxes, that are compared at once: a cloud can be made of any number of small clusters."""


class Detect3D:
    """Boxes of the configured classes in the combined cloud."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Load the engine named by `detect3d.method`."""
        self._site_frame = rig.site_frame
        self._min_score = config.detect3d.min_score
        self._detector = _detector(rig, config)

    def __call__(self, combined: CombinedCloud) -> Boxes3D:
        """Boxes in the site frame, in order of falling score, then of x and y."""
        found = self._detector(combined)
        order = np.lexsort((found.centers[:, 1], found.centers[:, 0], -found.scores))
        order = order[(found.scores[order] >= self._min_score) & (found.class_ids[order] >= 0)]
        order = order[_suppress_overlaps(found.centers[order], found.sizes[order], found.yaws[order])]
        return Boxes3D(
            combined.cloud.stamp_ns,
            self._site_frame,
            found.centers[order],
            found.sizes[order],
            wrap_angle(found.yaws[order]),
            found.scores[order].astype(np.float32),
            found.class_ids[order].astype(np.int32),
            found.point_counts[order].astype(np.int32),
            found.covariances[order],
        )


def _detector(rig: Rig, config: Config) -> Detector3D:
    match config.detect3d.method:
        case "cluster":
            return ClusterDetector(rig, config)
        case "none":
            return lambda _: Candidates3D.empty()


def _suppress_overlaps(centers: F64, sizes: F64, yaws: F64) -> Indices:
    """Rows of the boxes that share little ground with any box kept before them."""
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    samples = centers[:, None, :2] + (grid * sizes[:, None, :2]) @ rotations_2d(yaws).transpose(0, 2, 1)  # (N, G, 2)
    boxes = np.column_stack([centers[:, :2], sizes[:, :2] / 2, np.cos(yaws), np.sin(yaws)])
    kept = np.zeros(0, np.intp)
    for start in range(0, len(centers), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(centers)))
        others = np.concatenate([kept, rows])
        rivals = _rivals(rows, others, boxes, samples)
        is_kept = others < start
        for place in range(len(rows)):
            is_kept[len(kept) + place] = not (rivals[place] & is_kept).any()
        kept = others[is_kept]
    return kept


def _rivals(rows: Indices, others: Indices, boxes: F64, samples: F64) -> Bools:
    """(R, O) whether a box or the other, which comes before it, has too much of its ground inside the other."""
    gap = boxes[rows, None, :2] - boxes[others, :2]
    reach_m = np.hypot(boxes[:, 2], boxes[:, 3])
    near = np.hypot(gap[..., 0], gap[..., 1]) <= reach_m[rows, None] + reach_m[others]
    first, second = np.nonzero(near & (others < rows[:, None]))
    found = np.zeros(near.shape, np.bool_)
    for start in range(0, len(first), PAIRS):
        i, j = first[start : start + PAIRS], second[start : start + PAIRS]
        a, b = rows[i], others[j]
        inside = np.maximum(_share_inside(boxes[a], samples[b]), _share_inside(boxes[b], samples[a]))
        found[i, j] = inside > OVERLAP_SHARE
    return found


def _share_inside(boxes: F64, samples: F64) -> F64:
    """(P,) share of the samples (P, G, 2) that lie inside of each box: centre, half its size, cosine, sine of yaw."""
    x, y = (samples - boxes[:, None, :2]).transpose(2, 0, 1)
    half_length, half_width, cos, sin = boxes[:, 2:].T[..., None]
    within = (np.abs(x * cos + y * sin) <= half_length) & (np.abs(y * cos - x * sin) <= half_width)
    return np.asarray(within.mean(1))
