"""Fusion: geometry from the lidars, class from the cameras, score from both.

Position, size, yaw and covariance of the 3D box are kept, even if the class from a camera does not suit the size. An
object without a match keeps class and score of its 3D box.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import F64, I32
from pipeline.core.detections import Boxes2D, Fused, Hypotheses
from pipeline.core.settings.config import Config

__all__ = ["Fuse"]


class Fuse:
    """Fusion of the 3D boxes of a frame with the matched 2D boxes."""

    def __init__(self, config: Config) -> None:
        self._class_count = len(config.classes)
        self._config = config.fuse

    def __call__(self, hypotheses: Hypotheses, camera_boxes: Mapping[str, Boxes2D]) -> Fused:
        """The objects of a frame.

        Class: each matched camera votes with its score; of classes with equal votes the 3D box's own wins, then the
        lowest class id. Score: 1 - (1 - lidar) x product of (1 - camera) over the matched cameras (noisy-or), the
        probability that at least one sensor is right if their errors are independent.

        Args:
            hypotheses: N boxes in the site frame, and their matches with `camera_boxes`.
            camera_boxes: By camera name.
        """
        lidar_boxes, matches = hypotheses.boxes, hypotheses.matches
        n = len(lidar_boxes)
        votes, missed = np.zeros((n, self._class_count)), 1.0 - lidar_boxes.scores.astype(np.float64)
        matched, in_view = np.zeros(n, np.int32), np.zeros(n, np.bool_)
        for name, boxes in camera_boxes.items():
            rows, rows2d = matches[name].pairs.T  # each row at most once, so indexed += adds correctly
            scores = boxes.scores[rows2d].astype(np.float64)
            votes[rows, boxes.class_ids[rows2d]] += scores
            missed[rows] *= 1.0 - scores
            matched[rows] += 1
            in_view |= np.isfinite(matches[name].projected_xyxy[:, 0])
        fused_scores = np.where(matched > 0, 1.0 - missed, lidar_boxes.scores).astype(np.float32)
        class_ids = _winners(votes, lidar_boxes.class_ids)
        objects = replace(lidar_boxes, scores=fused_scores, class_ids=class_ids)
        doubted = in_view & (matched == 0)
        kept = fused_scores >= np.where(doubted, self._config.min_score_unconfirmed, 0.0)
        kept &= fused_scores >= self._config.min_score
        return Fused(objects.select(kept), matched[kept], np.flatnonzero(kept).astype(np.int64))


def _winners(votes: F64, own_ids: I32) -> I32:
    """(N,) class id with the most votes (N, C); the box's own unless another has more."""
    best = votes.argmax(1)
    rows = np.arange(len(votes))
    return np.where(votes[rows, own_ids] >= votes[rows, best], own_ids, best).astype(np.int32)
