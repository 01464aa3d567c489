"""2D boxes of the cameras against what their images show: which shows which."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I32, Bools, check_array
from pipeline.evaluation.assignment import pairs_of_equal
from pipeline.evaluation.detection.matching import match_by_score, ranks_by_score
from pipeline.evaluation.detection.tables import FALSE, IGNORED
from pipeline.evaluation.records import UNKNOWN, ImageBoxes, TruthBoxes2D

__all__ = ["IMAGE_IOUS", "ImageTable", "is_evaluated_2d", "match_images", "no_image_boxes"]

IMAGE_IOUS = (0.5, 0.7)
"""IoUs of upright rectangles from which a detection counts as right; the first is also that of the errors."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageTable:
    """The detections of a camera in all images.

    Attributes:
        class_ids: (N,) int32, row of the configured classes.
        scores: (N,) float32.
        matches: (K, N) int32 by `IMAGE_IOUS`, row of the object in its batch of images; or `FALSE`, `IGNORED`.
        errors: (5, N) float32: IoU with the object that is shown, and found minus true left, top, right and bottom
            edge in pixels; NaN where none is shown.
    """

    class_ids: I32
    scores: F32
    matches: I32
    errors: F32

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("class_ids", self.class_ids, (n,), np.int32)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("matches", self.matches, (len(IMAGE_IOUS), n), np.int32)
        check_array("errors", self.errors, (5, n), np.float32)

    def __len__(self) -> int:
        return len(self.scores)


def no_image_boxes() -> ImageTable:
    """No detections."""
    matches, errors = np.zeros((len(IMAGE_IOUS), 0), np.int32), np.zeros((5, 0), np.float32)
    return ImageTable(np.zeros(0, np.int32), np.zeros(0, np.float32), matches, errors)


def is_evaluated_2d(truth: TruthBoxes2D, min_pixels: int) -> Bools:
    """(T,) which objects of an image are evaluated: of a class, not ignored, not known to have too few pixels."""
    enough = (truth.image_pixels >= min_pixels) | (truth.image_pixels == UNKNOWN)
    evaluated: Bools = enough & (truth.class_ids >= 0) & ~truth.is_ignored
    return evaluated


def match_images(images: Sequence[ImageBoxes], truths: Sequence[TruthBoxes2D], min_pixels: int) -> ImageTable:
    """Match the detections of at least one image.

    A false detection is ignored if an ignored object of any class, or a region that nobody labelled, holds as large a
    share of it as the criterion asks for.

    Args:
        images: The images.
        truths: What each of them shows.
        min_pixels: An object with fewer pixels is ignored.
    """
    xyxy = np.concatenate([image.found.xyxy for image in images]).astype(np.float64)
    class_ids = np.concatenate([image.found.class_ids for image in images])
    scores = np.concatenate([image.found.scores for image in images])
    true_xyxy = np.concatenate([truth.xyxy for truth in truths]).astype(np.float64)
    true_ids = np.concatenate([truth.class_ids for truth in truths])
    evaluated = np.concatenate([is_evaluated_2d(truth, min_pixels) for truth in truths])
    found, shown = pairs_of_equal(_numbers([len(image.found) for image in images]), _numbers(list(map(len, truths))))
    iou, share = _overlaps(xyxy[found], true_xyxy[shown])

    same = evaluated[shown] & (class_ids[found] == true_ids[shown])
    order = np.lexsort((shown, -iou, found))
    ranks = ranks_by_score(scores)
    matches = np.empty((len(IMAGE_IOUS), len(scores)), np.int32)
    for row, limit in enumerate(IMAGE_IOUS):
        rows = order[(same & (iou >= limit))[order]]
        matched = match_by_score(found[rows], shown[rows], ranks, len(true_ids))
        ignored = np.zeros(len(scores), np.bool_)
        ignored[found[~evaluated[shown] & (share >= limit)]] = True
        matches[row] = np.where(ignored & (matched == FALSE), IGNORED, matched)

    errors = np.full((5, len(scores)), np.nan, np.float32)
    right = np.flatnonzero(matches[0] >= 0)
    errors[0, right] = _overlaps(xyxy[right], true_xyxy[matches[0, right]])[0]
    errors[1:, right] = (xyxy[right] - true_xyxy[matches[0, right]]).T
    return ImageTable(class_ids, scores, matches, errors)


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
