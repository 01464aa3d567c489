"""Layouts with a row for each object: exports with suppression inside, and networks of the DETR family."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F32, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.onnx.layouts.layout import Size, best_class, check_shape, corners_of
from lidcam.pipeline.detectors.protocols import Candidates2D


@dataclass(frozen=True, slots=True)
class EndToEndReader:
    """YOLOv10, YOLO26, exports with `nms=True`: (N, K, 6), rows of left, top, right, bottom in pixels, score, class."""

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del size_px, min_score
        check_shape(outputs[0], (count, None, 6), "an end-to-end output")
        return [_listed(rows[:, :4], rows[:, 4], rows[:, 5]) for rows in outputs[0]]


@dataclass(frozen=True, slots=True)
class RtDetrReader:
    """RT-DETR as Ultralytics exported it up to 8.3: (N, Q, 4 + C), rows of centre and size in shares, C scores.

    Attributes:
        class_count: C.
    """

    class_count: int

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del min_score
        check_shape(outputs[0], (count, None, 4 + self.class_count), "an RT-DETR output")
        return [_scored(rows[:, :4], rows[:, 4:], size_px) for rows in outputs[0]]


@dataclass(frozen=True, slots=True)
class RtDetrListReader:
    """RT-DETR as Ultralytics exports it since 8.4: (N, K, 6), rows of centre and size in shares, score, class."""

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del min_score
        check_shape(outputs[0], (count, None, 6), "an RT-DETR output")
        return [_listed(_in_pixels(rows[:, :4], size_px), rows[:, 4], rows[:, 5]) for rows in outputs[0]]


@dataclass(frozen=True, slots=True)
class DetrReader:
    """RT-DETR, D-FINE, RF-DETR: boxes (N, Q, 4), and scores (N, Q, C) that a sigmoid makes probabilities.

    Boxes are centre and size in shares of the image.

    Attributes:
        class_count: C.
        boxes_at: Which output has the boxes.
        scores_at: Which output has the scores.
    """

    class_count: int
    boxes_at: int
    scores_at: int

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del min_score
        boxes, logits = outputs[self.boxes_at], outputs[self.scores_at]
        check_shape(boxes, (count, None, 4), "boxes")
        check_shape(logits, (count, boxes.shape[1], self.class_count), "scores")
        from scipy.special import expit  # a fifth of a second, for these networks alone

        return [_scored(one, expit(scores), size_px) for one, scores in zip(boxes, logits, strict=True)]


@dataclass(frozen=True, slots=True)
class DfineReader:
    """RT-DETRv2, D-FINE and DEIM with their post-processing: classes (N, K), boxes (N, K, 4), scores (N, K).

    Boxes are left, top, right, bottom in pixels of the size that is given as a second input.

    Attributes:
        labels_at: Which output has the classes.
        boxes_at: Which output has the boxes.
        scores_at: Which output has the scores.
    """

    labels_at: int
    boxes_at: int
    scores_at: int

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del size_px, min_score
        labels, boxes, scores = outputs[self.labels_at], outputs[self.boxes_at], outputs[self.scores_at]
        check_shape(boxes, (count, None, 4), "boxes")
        check_shape(labels, (count, boxes.shape[1]), "classes")
        check_shape(scores, (count, boxes.shape[1]), "scores")
        return [_listed(*one) for one in zip(boxes, scores, labels, strict=True)]


def _scored(boxes: F32, scores: F32, size_px: Size) -> Candidates2D:
    """Boxes in shares of the image (Q, 4) and their scores by class (Q, C)."""
    return Candidates2D(_in_pixels(boxes, size_px), *best_class(scores))


def _in_pixels(boxes: F32, size_px: Size) -> F32:
    """Corners in pixels of boxes (Q, 4) by centre and size in shares of the image."""
    image = np.array([size_px[1], size_px[0]], np.float32)
    return corners_of(boxes[:, :2] * image, boxes[:, 2:] * image)


def _listed(xyxy: F32, scores: F32, labels: Array) -> Candidates2D:
    """Boxes with a class each; rows without a score are filling."""
    taken = scores > 0
    classes = labels[taken].astype(np.float64)
    is_class = (classes >= 0) & (classes < 2**31) & (classes == np.floor(classes))
    if not is_class.all():
        raise ModelError(f"expected numbers of classes, found {classes[~is_class][0]:g}")
    return Candidates2D(xyxy[taken], scores[taken], classes.astype(np.int64))
