"""Detection in the combined cloud: from an engine's proposals to the boxes of a frame."""

import numpy as np

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
    x, y = (samples.reshape(-1, 2) - centers[:, None, :2]).transpose(2, 0, 1)  # (N, N G): from each box's centre
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    half_length, half_width = sizes[:, :2].T[..., None] / 2
    within = (np.abs(x * cos + y * sin) <= half_length) & (np.abs(y * cos - x * sin) <= half_width)
    inside = within.reshape(len(sizes), len(sizes), len(grid)).mean(2)
    rivals = np.maximum(inside, inside.T) > OVERLAP_SHARE
    kept: list[int] = []
    for row in range(len(centers)):
        if not rivals[row, kept].any():
            kept.append(row)
    return np.array(kept, np.intp)
