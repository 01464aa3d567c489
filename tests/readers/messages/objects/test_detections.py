import builders
import numpy as np
import pytest

from pipeline.core.errors import MessageError
from pipeline.core.settings.config import Config
from pipeline.core.settings.recording import LimitsConfig
from readers.messages.objects.found import ObjectClasses
from readers.messages.vision.detections3d import decode_detected_boxes

CLASSES = ObjectClasses(Config())
MSGTYPE = "vision_msgs/msg/Detection3DArray"
BOX = {"center": {"orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}


def hypothesis(label: str, score: float, variance: float = 0.0) -> builders.Fields:
    return {"hypothesis": {"class_id": label, "score": score}, "pose": {"covariance": np.eye(6).reshape(36) * variance}}


def test_score_and_covariance_are_those_of_the_best_hypothesis() -> None:
    results = [hypothesis("bus", 0.2, 1), hypothesis("car", 0.7, 2), hypothesis("truck", 0.7, 3)]
    results.append(hypothesis("lidar_points", 88, 4))
    body = {"header": builders.header(5, "a"), "detections": [{"results": results, "bbox": BOX}, {"bbox": BOX}]}
    found = decode_detected_boxes(builders.raw("/o", MSGTYPE, body, 5), CLASSES)
    assert found.class_ids.tolist() == [CLASSES.id_of("car")]
    np.testing.assert_array_equal(found.boxes.covariances, 2 * np.eye(6)[None])
    assert dict(found.unused) == {"no class with a score": 1}


def test_too_many_boxes() -> None:
    many = builders.raw("/o", MSGTYPE, {"detections": [{"bbox": BOX}] * 4}, 5)
    with pytest.raises(MessageError, match=r"/o: 4 boxes, expected at most 3: raise limits\.max_boxes"):
        decode_detected_boxes(many, CLASSES, limits=LimitsConfig(max_boxes=3))
