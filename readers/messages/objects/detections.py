"""Objects of a vision_msgs/Detection3DArray of any version (see `readers.messages.vision.detections3d`)."""

import numpy as np

from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.messages.boundary.decoding import decoder
from readers.messages.objects.found import FoundObjects, ObjectClasses, found_objects
from readers.messages.vision.detections3d import DETECTIONS_3D, box_numbers
from readers.messages.vision.hypotheses import best_and_counts, box_rows

__all__ = ["decode_detected_boxes"]


@decoder
def decode_detected_boxes(
    message: RawMessage, classes: ObjectClasses, *, limits: LimitsConfig = DEFAULT_LIMITS
) -> FoundObjects:
    """The objects of a message, each with the class, score and covariance of its best hypothesis.

    Raises:
        MessageError: not a Detection3DArray of a known layout, or more boxes than `limits` allow.
    """
    rows = box_rows(message, DETECTIONS_3D, box_numbers, 10, limits)
    best, _ = best_and_counts(rows)
    has_best = best >= 0
    covariances, scores = np.zeros((len(best), 36)), np.full(len(best), np.nan)
    covariances[has_best], scores[has_best] = rows.covariances[best[has_best]], rows.scores[best[has_best]]
    labels = [rows.labels[row] if row >= 0 else None for row in best.tolist()]
    return found_objects(message.stamp_ns, rows.frame_id, rows.boxes, covariances, scores, labels, classes)
