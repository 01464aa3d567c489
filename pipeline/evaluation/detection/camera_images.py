"""2D boxes of one camera against the true objects in its images."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, Bools, Rows, select_rows
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.settings.config import ALL_CLASSES, Config
from lidcam.pipeline.evaluation.detection.averages import Averages, mean_figures
from lidcam.pipeline.evaluation.detection.counts import count_figures
from lidcam.pipeline.evaluation.detection.curves import average_precision, curve_of, ratio
from lidcam.pipeline.evaluation.detection.matching import by_falling_score, match_by_score, ranks_by_score
from lidcam.pipeline.evaluation.detection.tables import FALSE, IGNORED
from lidcam.pipeline.evaluation.evaluation_frame import Figures, ImageBoxes, TruthBoxes2D
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.vans import Vans, as_found

MIN_IOU = 0.5
"""Smallest IoU of upright rectangles at which a detection is right."""


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The detections of a camera in all images."""

    class_ids: I32  # (N,) int32, row of the configured classes
    scores: F32  # (N,) float32
    matches: I32  # (N,) int32, row of the object in its image; or `FALSE`, `IGNORED`


class CameraImages:
    """Matches the 2D boxes of one camera image by image, and keeps what the figures need."""

    def __init__(self, config: Config) -> None:
        self._class_names, self._vans = config.class_names, Vans(config)
        self._found = Pieces(_Found)
        self._truth_counts = np.zeros(len(config.classes), np.int64)
        self._ignored_counts = np.zeros(len(config.classes) + 1, np.int64)  # the last one: of no configured class
        self._images = 0
        self._images_without_truth = 0

    def add_image(self, image: ImageBoxes) -> None:
        """Take in one image; the numbers in it are finite, as readers make sure."""
        if image.truth is None:
            self._images_without_truth += 1
            return
        self._images += 1
        truth, classes = image.truth, len(self._class_names)
        is_evaluated = (truth.image_pixels != 0) & (truth.class_ids >= 0) & ~truth.is_ignored
        found = _matched(image.found, truth, is_evaluated, self._vans)
        self._found.append(found)
        ids = as_found(truth.class_ids, found.matches, found.class_ids)
        self._truth_counts += np.bincount(ids[is_evaluated], minlength=classes)
        self._ignored_counts += np.bincount(ids[~is_evaluated] % (classes + 1), minlength=classes + 1)

    def figures(self) -> Figures:
        """All figures, by class."""
        found = self._found.table()
        figures: dict[str, dict[str, float | int | None]] = {}
        averages: list[Averages] = []
        for class_id, name in enumerate(self._class_names):
            counts = int(self._truth_counts[class_id]), int(self._ignored_counts[class_id])
            figures[name], average = self._of(select_rows(found, found.class_ids == class_id), *counts)
            averages.append({"ap_2d_r40_50": average})
            figures[name] |= averages[-1]
        pooled, _ = self._of(found, int(self._truth_counts.sum()), int(self._ignored_counts.sum()))
        return {**figures, ALL_CLASSES: {**pooled, **mean_figures(averages)}}

    def _of(self, found: _Found, truth: int, left_out: int) -> tuple[dict[str, float | int | None], float | None]:
        """Counts of some detections, and their average precision."""
        rows: Rows = np.flatnonzero(found.matches != IGNORED)
        counted = select_rows(found, rows[by_falling_score(found.scores[rows])])
        is_right = counted.matches != FALSE
        curve = curve_of(counted.scores, is_right, truth)
        figures = {
            **count_figures(curve, len(found.scores) - len(rows), left_out),
            "false_per_image": ratio(int((~is_right).sum()), self._images),
            "images": self._images,
            "images_without_truth": self._images_without_truth,
        }
        return figures, average_precision(curve.right, curve.precision, truth)


def _matched(found: Boxes2D, truth: TruthBoxes2D, is_evaluated: Bools, vans: Vans) -> _Found:
    """Match the detections of one image; `is_evaluated` (T,) are the objects that have to be found.

    A false detection is ignored if an ignored object of any class, or a region that nobody labelled, holds as large a
    share of it as `MIN_IOU`.
    """
    rows, shown = np.divmod(np.arange(len(found) * len(truth)), max(len(truth), 1))
    iou, share = _overlaps(found.xyxy[rows].astype(np.float64), truth.xyxy[shown].astype(np.float64))
    is_van = vans.among(truth.class_ids, truth.labels)
    fits = vans.fit(truth.class_ids[shown], is_van[shown], found.class_ids[rows])
    order = np.lexsort((shown, -iou, rows))
    pairs = order[(is_evaluated[shown] & fits & (iou >= MIN_IOU))[order]]
    matches = match_by_score(rows[pairs], shown[pairs], ranks_by_score(found.scores), len(truth))
    ignored = np.zeros(len(found), np.bool_)
    ignored[rows[~is_evaluated[shown] & (share >= MIN_IOU)]] = True
    matches = np.where(ignored & (matches == FALSE), IGNORED, matches).astype(np.int32)
    return _Found(found.class_ids, found.scores, matches)


def _overlaps(found: F64, true: F64) -> tuple[F64, F64]:
    """IoU of rectangles (P, 4) row by row, and the share of the first that the second holds."""
    extent = np.clip(np.minimum(found[:, 2:], true[:, 2:]) - np.maximum(found[:, :2], true[:, :2]), 0, None)
    shared = extent.prod(1)
    area, true_area = (np.clip(boxes[:, 2:] - boxes[:, :2], 0, None).prod(1) for boxes in (found, true))
    joined = area + true_area - shared
    iou = np.divide(shared, joined, out=np.zeros(len(shared)), where=joined > 0)
    return iou, np.divide(shared, area, out=np.zeros(len(shared)), where=area > 0)
