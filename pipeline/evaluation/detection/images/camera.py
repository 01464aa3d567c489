"""The figures of the 2D boxes of one camera."""

import numpy as np

from pipeline.core.arrays import F32, I32, Bools, Indices
from pipeline.core.settings.config import ALL_CLASSES, Config
from pipeline.evaluation.detection.averages import Averages, mean_figures, overlap_name
from pipeline.evaluation.detection.calibration import calibration_figures
from pipeline.evaluation.detection.counts import count_figures, threshold_figures
from pipeline.evaluation.detection.curves import R11, R40, Curve, average_precision, curve_of, ratio
from pipeline.evaluation.detection.errors import bias, spread
from pipeline.evaluation.detection.images.matching import (
    IMAGE_IOUS,
    ImageTable,
    is_evaluated_2d,
    match_images,
    no_image_boxes,
)
from pipeline.evaluation.detection.matching import by_falling_score
from pipeline.evaluation.detection.objects import check_class_ids, check_numbers
from pipeline.evaluation.detection.tables import IGNORED
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.records import UNKNOWN, Figure, Figures, ImageBoxes, TruthBoxes2D

__all__ = ["CameraImages"]

_MAX_IMAGES = 128
"""Images that are matched together."""

_EDGES = ("left_px", "top_px", "right_px", "bottom_px")


class CameraImages:
    """Matches the 2D boxes of one camera, some images at a time, and keeps what the figures need.

    Args:
        config: Classes and settings of the evaluation.
    """

    def __init__(self, config: Config) -> None:
        self._class_names = config.class_names
        self._min_pixels = config.evaluate.min_image_pixels
        self._found: Pieces[ImageTable] = Pieces(no_image_boxes(), by_criterion=("matches", "errors"))
        self._truth_counts = np.zeros(len(config.classes), np.int64)
        self._ignored_counts = np.zeros(len(config.classes) + 1, np.int64)  # the last one: of no configured class
        self._images = 0
        self._images_without_truth = 0
        self._waiting: list[ImageBoxes] = []
        self._waiting_truth: list[TruthBoxes2D] = []

    def add(self, image: ImageBoxes) -> None:
        """Take in one image.

        Raises:
            ValueError: a class id is none of the configured classes, or a number is not finite.
        """
        if image.truth is None:
            self._images_without_truth += 1
            return
        self._check("found", 0, image.found.class_ids, image.found.xyxy, image.found.scores)
        self._check("truth", UNKNOWN, image.truth.class_ids, image.truth.xyxy)
        self._images += 1
        self._waiting.append(image)
        self._waiting_truth.append(image.truth)
        if len(self._waiting) >= _MAX_IMAGES:
            self._match()

    def _check(self, side: str, lowest_id: int, class_ids: I32, *numbers: F32) -> None:
        check_numbers(side, *numbers)
        check_class_ids(side, class_ids, range(lowest_id, len(self._class_names)))

    def _match(self) -> None:
        if not self._waiting:
            return
        self._found.append(match_images(self._waiting, self._waiting_truth, self._min_pixels))
        ids = np.concatenate([truth.class_ids for truth in self._waiting_truth])
        evaluated = np.concatenate([is_evaluated_2d(truth, self._min_pixels) for truth in self._waiting_truth])
        classes = len(self._class_names)
        self._truth_counts += np.bincount(ids[evaluated], minlength=classes)
        self._ignored_counts += np.bincount(ids[~evaluated] % (classes + 1), minlength=classes + 1)
        self._waiting, self._waiting_truth = [], []

    def figures(self) -> Figures:
        """All figures, by class."""
        self._match()
        found = self._found.table()
        rows = [found.class_ids == class_id for class_id in range(len(self._class_names))]
        averages = [
            self._averages(found, mask, int(count)) for mask, count in zip(rows, self._truth_counts, strict=True)
        ]
        figures: dict[str, Figures] = {}
        for class_id, name in enumerate(self._class_names):
            truth, left_out = int(self._truth_counts[class_id]), int(self._ignored_counts[class_id])
            figures[name] = {**self._pooled(found, rows[class_id], truth, left_out), **averages[class_id]}
        everything = np.ones(len(found), np.bool_)
        pooled = self._pooled(found, everything, int(self._truth_counts.sum()), int(self._ignored_counts.sum()))
        return {**figures, ALL_CLASSES: {**pooled, **mean_figures(averages)}}

    def _averages(self, found: ImageTable, mask: Bools, truth: int) -> Averages:
        averages: Averages = {}
        for row, iou in enumerate(IMAGE_IOUS):
            curve = _curve(found, _counted(found, mask, row), row, truth)
            for name, recalls in (("r40", R40), ("r11", R11)):
                value = average_precision(curve.right, curve.precision, truth, recalls)
                averages[f"ap_2d_{name}_{overlap_name(iou)}"] = value
        return averages

    def _pooled(self, found: ImageTable, mask: Bools, truth: int, left_out: int) -> dict[str, Figures | Figure]:
        counted = _counted(found, mask, 0)
        is_right = found.matches[0, counted] >= 0
        curve = _curve(found, counted, 0, truth)
        errors = found.errors[:, counted[is_right]]
        counts = count_figures(curve, int(mask.sum()) - len(counted), left_out)
        return {
            **counts,
            "false_per_image": ratio(len(counted) - int(is_right.sum()), self._images),
            "images": self._images,
            "images_without_truth": self._images_without_truth,
            "mean_iou": bias(errors[0]),
            "edges": {
                name: {"bias": bias(errors[row]), **spread(errors[row])} for row, name in enumerate(_EDGES, start=1)
            },
            "thresholds": threshold_figures(curve),
            "calibration": calibration_figures(found.scores[counted], is_right),
        }


def _counted(found: ImageTable, mask: Bools, row: int) -> Indices:
    """The detections that count at an IoU, by falling score."""
    rows = np.flatnonzero(mask & (found.matches[row] != IGNORED))
    return rows[by_falling_score(found.scores[rows])]


def _curve(found: ImageTable, rows: Indices, row: int, truth: int) -> Curve:
    return curve_of(found.scores[rows], found.matches[row, rows] >= 0, truth)
