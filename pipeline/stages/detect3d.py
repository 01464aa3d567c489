"""Detection in the combined cloud: from an engine's proposals to the boxes of a frame."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from pipeline.core.arrays import F64, Indices
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
"""Boxes whose neighbours are sought, and pairs that are compared, at once: a cloud may hold many small clusters."""


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
    kept = np.ones(len(centers), np.bool_)
    for first, second in _rivals(boxes, samples):
        for row, others in _by_row(first, second):
            kept[row] = not kept[others].any()
    return np.flatnonzero(kept)


def _rivals(boxes: F64, samples: F64) -> Iterator[tuple[Indices, Indices]]:
    """Boxes, and one before each of them, of which one has too much of its ground inside the other; in their order."""
    if not len(boxes):
        return
    reach_m = np.hypot(boxes[:, 2], boxes[:, 3])
    tree = cKDTree(boxes[:, :2])
    for start in range(0, len(boxes), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(boxes)))
        largest_m = (reach_m[rows] + reach_m.max()) * (1 + 1e-9)
        lists = tree.query_ball_point(boxes[rows, :2], largest_m)
        first, second = np.repeat(rows, [len(one) for one in lists]), np.concatenate(lists).astype(np.intp)
        is_before = second < first
        first, second = first[is_before], second[is_before]
        gap = boxes[first, :2] - boxes[second, :2]
        is_near = np.hypot(gap[:, 0], gap[:, 1]) <= reach_m[first] + reach_m[second]
        first, second = first[is_near], second[is_near]
        inside = np.empty(len(first))
        for begin in range(0, len(first), PAIRS):
            i, j = first[begin : begin + PAIRS], second[begin : begin + PAIRS]
            inside[begin : begin + PAIRS] = np.maximum(
                _share_inside(boxes[i], samples[j]), _share_inside(boxes[j], samples[i])
            )
        is_rival = inside > OVERLAP_SHARE
        yield first[is_rival], second[is_rival]


def _by_row(first: Indices, second: Indices) -> Iterator[tuple[int, Indices]]:
    """The second ones of each first one, which come together."""
    rows, starts = np.unique(first, return_index=True)
    yield from zip(
        rows.tolist(), np.split(second, starts[1:]), strict=False
    )  # without any, the split is one empty part


def _share_inside(boxes: F64, samples: F64) -> F64:
    """(P,) share of the samples (P, G, 2) that lie inside of each box: centre, half its size, cosine, sine of yaw."""
    x, y = (samples - boxes[:, None, :2]).transpose(2, 0, 1)
    half_length, half_width, cos, sin = boxes[:, 2:].T[..., None]
    within = (np.abs(x * cos + y * sin) <= half_length) & (np.abs(y * cos - x * sin) <= half_width)
    return np.asarray(within.mean(1))
