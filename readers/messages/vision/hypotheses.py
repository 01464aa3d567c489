"""The rows of boxes and their hypotheses: from any layout, and what the hypotheses say."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, Indices
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.vision_numbers import count_of
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.objects.found import check_boxes

_NO_COVARIANCE = np.zeros(36)


class BoxRows(NamedTuple):
    """The content of an array of boxes, as recorded."""

    frame_id: str  # As recorded
    # (N, 10) float64 in space: position x, y, z; orientation x, y, z, w; size x, y, z. (N, 5) in images: centre x, y;
    # angle; size x, y
    boxes: F64
    ids: list[str]  # Of each box
    of_box: list[int]  # Row of the box of each hypothesis
    labels: list[str]  # Class of each hypothesis; a number as text
    scores: F64  # (H,) float64
    covariances: F64  # (H, 36) float64, of each hypothesis' pose


def box_rows(
    message: RawMessage, msgtype: str, box_of: Callable[[Any], Sequence[float]], numbers: int, limits: RecordingLimits
) -> BoxRows:
    """The content of an array of boxes: of each the `numbers` that `box_of` takes from its decoded `bbox`.

    Raises:
        MessageError: the message is of another type, cannot be decoded, or holds more boxes.
    """
    array = deserialize_as(message, msgtype, limits=limits)
    check_boxes(array.detections, message.topic, limits)
    results = [(row, result) for row, detection in enumerate(array.detections) for result in detection.results]
    hypotheses = [getattr(result, "hypothesis", result) for _, result in results]
    covariances = [_covariance(result) for _, result in results]
    boxes = np.array([box_of(detection.bbox) for detection in array.detections], np.float64).reshape(-1, numbers)
    return BoxRows(
        array.header.frame_id,
        boxes,
        [str(getattr(one, "id", "") or getattr(one, "tracking_id", "")) for one in array.detections],
        [row for row, _ in results],
        [str(one.class_id if hasattr(one, "class_id") else one.id) for one in hypotheses],
        np.array([one.score for one in hypotheses], np.float64),
        np.array(covariances, np.float64).reshape(-1, 36),
    )


def _covariance(result: Any) -> F64:
    """(36,) of a hypothesis' pose; zeros where the layout has none, as it may in images."""
    found = np.asarray(getattr(getattr(result, "pose", None), "covariance", _NO_COVARIANCE), np.float64)
    return found if found.shape == _NO_COVARIANCE.shape else _NO_COVARIANCE


def best_and_counts(rows: BoxRows) -> tuple[Indices, dict[str, F64]]:
    """The best hypothesis of each box, and what the others count.

    Returns:
        (N,) row of the hypothesis with the highest score that is a class, of equal ones the first, -1 without one; and
        (N,) float64 by what is counted (see `count_of`), NaN where a box has no such hypothesis. Scores that are not
        finite say nothing.
    """
    n = len(rows.boxes)
    best, highest = [-1] * n, [-math.inf] * n
    counts: dict[str, F64] = {}
    for row, (box, label, score) in enumerate(zip(rows.of_box, rows.labels, rows.scores.tolist(), strict=True)):
        if not math.isfinite(score):
            continue
        if name := count_of(label.strip()):
            if name not in counts:
                counts[name] = np.full(n, np.nan)
            counts[name][box] = score
        elif score > highest[box]:
            best[box], highest[box] = row, score
    return np.array(best, np.intp), counts
