"""2D boxes of one camera against the true objects in its images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, Bools, Rows, select_rows
from lidcam.pipeline.core.settings.config import ALL_CLASSES, Config
from lidcam.pipeline.evaluation.assignment import pairs_of_equal
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

MAX_IMAGES = 128
"""Largest number of images that are matched together."""


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The detections of a camera in all images."""

    class_ids: I32  # (N,) int32, row of the configured classes
    scores: F32  # (N,) float32
    matches: I32  # (N,) int32, row of the object in its batch of images; or `FALSE`, `IGNORED`


class CameraImages:
    """Matches the 2D boxes of one camera, some images at a time, and keeps what the figures need."""

    def __init__(self, config: Config) -> None:
        self._class_names, self._vans = config.class_names, Vans(config)
        self._found = Pieces(_Found)
        self._truth_counts = np.zeros(len(config.classes), np.int64)
        self._ignored_counts = np.zeros(len(config.classes) + 1, np.int64)  # the last one: of no configured class
        self._images = 0
        self._images_without_truth = 0
        self._waiting: list[tuple[ImageBoxes, TruthBoxes2D]] = []

    def add_image(self, image: ImageBoxes) -> None:
        """Take in one image; the numbers in it are finite, as readers make sure."""
        if image.truth is None:
            self._images_without_truth += 1
            return
        self._images += 1
        self._waiting.append((image, image.truth))
        if len(self._waiting) >= MAX_IMAGES:
            self._match()

    def figures(self) -> Figures:
        """All figures, by class."""
        self._match()
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

    def _match(self) -> None:
        if not self._waiting:
            return
        images, truths = zip(*self._waiting, strict=True)
        self._waiting = []
        ids = np.concatenate([truth.class_ids for truth in truths])
        evaluated = np.concatenate([self._is_evaluated(truth) for truth in truths])
        found = _matched(images, truths, evaluated, self._vans)
        self._found.append(found)
        ids = as_found(ids, found.matches, found.class_ids)
        classes = len(self._class_names)
        self._truth_counts += np.bincount(ids[evaluated], minlength=classes)
        self._ignored_counts += np.bincount(ids[~evaluated] % (classes + 1), minlength=classes + 1)

    def _is_evaluated(self, truth: TruthBoxes2D) -> Bools:
        """(T,) whether objects are of a class, not ignored, and not known to have no pixel."""
        return np.asarray((truth.image_pixels != 0) & (truth.class_ids >= 0) & ~truth.is_ignored)

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


def _matched(images: Sequence[ImageBoxes], truths: Sequence[TruthBoxes2D], evaluated: Bools, vans: Vans) -> _Found:
    """Match the detections of at least one image; `evaluated` (T,) are the objects of all images that have to be found.

    A false detection is ignored if an ignored object of any class, or a region that nobody labelled, holds as large a
    share of it as `MIN_IOU`.
    """
    xyxy = np.concatenate([image.found.xyxy for image in images]).astype(np.float64)
    class_ids = np.concatenate([image.found.class_ids for image in images])
    scores = np.concatenate([image.found.scores for image in images])
    true_xyxy = np.concatenate([truth.xyxy for truth in truths]).astype(np.float64)
    true_ids = np.concatenate([truth.class_ids for truth in truths])
    is_van = vans.among(true_ids, np.concatenate([truth.labels for truth in truths]))
    found, shown = pairs_of_equal(_numbers([len(image.found) for image in images]), _numbers(list(map(len, truths))))
    iou, share = _overlaps(xyxy[found], true_xyxy[shown])
    order = np.lexsort((shown, -iou, found))
    fits = vans.fit(true_ids[shown], is_van[shown], class_ids[found])
    rows = order[(evaluated[shown] & fits & (iou >= MIN_IOU))[order]]
    matches = match_by_score(found[rows], shown[rows], ranks_by_score(scores), len(true_ids))
    ignored = np.zeros(len(scores), np.bool_)
    ignored[found[~evaluated[shown] & (share >= MIN_IOU)]] = True
    return _Found(class_ids, scores, np.where(ignored & (matches == FALSE), IGNORED, matches).astype(np.int32))


def _numbers(counts: Sequence[int]) -> I32:
    return np.repeat(np.arange(len(counts), dtype=np.int32), counts)


def _overlaps(found: F64, true: F64) -> tuple[F64, F64]:
    """IoU of rectangles (P, 4) row by row, and the share of the first that the second holds."""
    extent = np.clip(np.minimum(found[:, 2:], true[:, 2:]) - np.maximum(found[:, :2], true[:, :2]), 0, None)
    shared = extent.prod(1)
    area, true_area = (np.clip(boxes[:, 2:] - boxes[:, :2], 0, None).prod(1) for boxes in (found, true))
    joined = area + true_area - shared
    iou = np.divide(shared, joined, out=np.zeros(len(shared)), where=joined > 0)
    return iou, np.divide(shared, area, out=np.zeros(len(shared)), where=area > 0)
