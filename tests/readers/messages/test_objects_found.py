from typing import Any

import builders
import numpy as np
import pytest
from object_messages import FORMATS, Format, Recorded, objects_message
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.detections import decode_detected_boxes
from lidcam.readers.messages.objects import DETECTED_OBJECTS, FoundObjects, ObjectClasses, decode_detected_objects

STAMP_NS = 1_700_000_000_123_456_789
CONFIG = Config()
CLASSES = ObjectClasses(CONFIG)
NO_VOLUME, NO_TURN = "box without a volume, or out of all bounds", "box without an orientation"


def decode(format_: Format, *objects: Recorded, **options: Any) -> FoundObjects:
    message = objects_message(format_, STAMP_NS, objects, **options)
    is_autoware = message.channel.msgtype in DETECTED_OBJECTS
    return (decode_detected_objects if is_autoware else decode_detected_boxes)(message, CLASSES)


@pytest.mark.parametrize("format_", FORMATS)
@pytest.mark.parametrize("count", [0, 40])
def test_the_same_objects_in_every_format(format_: Format, count: int) -> None:
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, 6, 6))
    covariances = root @ root.transpose(0, 2, 1)
    turns = Rotation.random(count, rng=rng) if count else None
    xyzw = np.zeros((0, 4)) if turns is None else turns.as_quat()
    centers, sizes = rng.normal(0, 30, (count, 3)), rng.uniform(0.1, 9, (count, 3))
    scores, names = rng.random(count, np.float32), ["car", "pedestrian", "truck", "bus"]
    objects = [
        Recorded(centers[k], names[k % 4], float(scores[k]), sizes[k], xyzw[k] * (1 + k), covariances[k])
        for k in range(count)
    ]
    found = decode(format_, *objects, frame_id="/lidar_top")
    assert (found.stamp_ns, found.frame_id, dict(found.unused)) == (STAMP_NS, "lidar_top", {})
    np.testing.assert_array_equal(found.boxes.centers, centers)
    np.testing.assert_array_equal(found.boxes.sizes, sizes)
    np.testing.assert_array_equal(found.boxes.covariances, covariances)
    np.testing.assert_array_equal(found.scores, scores)
    if turns is not None:
        np.testing.assert_allclose(found.boxes.rotations, turns.as_matrix(), atol=1e-12)
    assert [CONFIG.class_names[row] for row in found.class_ids] == [one.label for one in objects]


@pytest.mark.parametrize("format_", FORMATS)
def test_what_cannot_be_used_is_counted(format_: Format) -> None:
    found = decode(
        format_,
        Recorded((1, 2, 3)),
        Recorded((1, 2, 3), "unicorn"),
        Recorded((1, 2, np.nan)),
        Recorded((1, 1e9, 3)),
        Recorded((1, 2, 3), size=(4, 0, 1)),
        Recorded((1, 2, 3), size=(4, np.nan, 1)),
        Recorded((1, 2, 3), xyzw=(0, 0, 0, 0)),
        Recorded((1, 2, 3), xyzw=(1e300, 0, 0, 1)),
        Recorded((1, 2, 3), score=np.nan),
        Recorded((9, 2, 3), score=7.0),
    )
    label = "unicorn" if format_ in ("foxy", "galactic", "humble") else "77"
    unknown = f"class {label!r} is not configured"
    assert dict(found.unused) == {NO_VOLUME: 4, NO_TURN: 2, unknown: 1, "no class with a score": 1}
    assert found.boxes.centers[:, 0].tolist() == [1, 9]
    assert found.scores.tolist() == [0.75, 1.0]


@pytest.mark.parametrize(
    ("numbers", "label", "name"),
    [
        ("labels", "1", "car"),
        ("labels", "7", None),
        ("labels", " Car ", "car"),
        ("coco", "2", "car"),
        ("coco", "0", "pedestrian"),
        ("coco", "80", None),
        ("coco", "VAN", "truck"),
        ("autoware", "1", "car"),
        ("autoware", "5", "bicycle"),
        ("autoware", "0", None),
        ("autoware", "12", None),
        ("autoware", "9" * 30, None),
        ("autoware", "\u0661", None),
    ],
)
def test_what_labels_and_numbers_mean(numbers: str, label: str, name: str | None) -> None:
    config = Config.model_validate({"detect3d": {"recorded": {"class_numbers": numbers}}})
    found = ObjectClasses(config).id_of(label)
    assert (None if found is None else config.class_names[found]) == name


BOX = {"center": {"orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}


def hypothesis(label: str, score: float, variance: float = 0.0) -> builders.Fields:
    return {"hypothesis": {"class_id": label, "score": score}, "pose": {"covariance": np.eye(6).reshape(36) * variance}}


def test_score_and_covariance_are_those_of_the_best_hypothesis() -> None:
    results = [hypothesis("bus", 0.2, 1), hypothesis("car", 0.7, 2), hypothesis("truck", 0.7, 3)]
    results.append(hypothesis("lidar_points", 88, 4))
    body = {"header": builders.header(5, "a"), "detections": [{"results": results, "bbox": BOX}, {"bbox": BOX}]}
    found = decode_detected_boxes(builders.raw("/o", "vision_msgs/msg/Detection3DArray", body, 5), CLASSES)
    assert found.class_ids.tolist() == [CLASSES.id_of("car")]
    np.testing.assert_array_equal(found.boxes.covariances, 2 * np.eye(6)[None])
    assert dict(found.unused) == {"no class with a score": 1}


def test_too_many_boxes() -> None:
    many = builders.raw("/o", "vision_msgs/msg/Detection3DArray", {"detections": [{"bbox": BOX}] * 4}, 5)
    with pytest.raises(MessageError, match=r"/o: 4 boxes, expected at most 3: raise limit_scale"):
        decode_detected_boxes(many, CLASSES, limits=RecordingLimits(max_boxes=3))
