import math
from typing import Any

import builders
import numpy as np
import pytest
from builders import Fields
from message_layouts import message_of_layout

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.detections import Detections2D, decode_detections2d
from lidcam.readers.messages.objects import ObjectClasses

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "vision_msgs/msg/Detection2DArray"
CLASS_IDS = {"car": 0, "person": 1, "Pedestrian": 1}
CLASSES, NUMBERED = ObjectClasses(CLASS_IDS), ObjectClasses(CLASS_IDS, "coco")

BOX = {"center": {"position": {"x": 30.0, "y": 40.0}}, "size_x": 20.0, "size_y": 10.0}


def detection(*classes: tuple[str, float], bbox: Fields = BOX) -> Fields:
    return {"results": [{"hypothesis": {"class_id": name, "score": score}} for name, score in classes], "bbox": bbox}


def box(x: float, y: float, size_x: float, size_y: float, theta: float = 0.0) -> Fields:
    return {"center": {"position": {"x": x, "y": y}, "theta": theta}, "size_x": size_x, "size_y": size_y}


def decode(
    *detections: Fields, classes: ObjectClasses = CLASSES, encoding: builders.Encoding = "cdr", **options: Any
) -> Detections2D:
    body = {"header": builders.header(STAMP_NS, "/camera"), "detections": list(detections)}
    return decode_detections2d(builders.raw("/boxes", MSGTYPE, body, STAMP_NS, encoding=encoding), classes, **options)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_boxes_classes_and_scores(encoding: builders.Encoding) -> None:
    xyxy = [[10.0, 20.0, 30.0, 50.0], [-5.5, 0.0, 600.25, 400.0]]
    body = builders.detection2d_array(xyxy, class_names=["person", "CAR"], scores=[0.25, 0.75], stamp_ns=STAMP_NS)
    found = decode_detections2d(builders.raw("/boxes", MSGTYPE, body, STAMP_NS, encoding=encoding), CLASSES)
    assert (found.boxes.stamp_ns, found.boxes.frame_id, dict(found.unused)) == (STAMP_NS, "camera", {})
    np.testing.assert_array_equal(found.boxes.xyxy, xyxy)
    np.testing.assert_array_equal(found.boxes.scores, [0.25, 0.75])
    np.testing.assert_array_equal(found.boxes.class_ids, [1, 0])


def test_ids_counts_and_other_classes() -> None:
    seen = {**detection(("car", 1.0), ("image_pixels", 250.0), ("occlusion", 0.25)), "id": "car7"}
    found = decode(seen, detection(("dog", 0.5), ("image_pixels", 9.0)), detection(("person", 1.0)), other_class_id=-1)
    assert (found.labels.tolist(), found.ids.tolist()) == (["car", "dog", "person"], ["car7", "", ""])
    np.testing.assert_array_equal(found.boxes.class_ids, [0, -1, 1])
    np.testing.assert_array_equal(found.boxes.scores, [1.0, 0.5, 1.0])
    np.testing.assert_array_equal(found.counts["image_pixels"], [250, 9, np.nan])
    np.testing.assert_array_equal(found.counts["occlusion"], [0.25, np.nan, np.nan])


def test_what_is_left_out_is_counted() -> None:
    found = decode(
        detection(("dog", 0.9)),
        detection(("car", 97.0)),
        detection(("dog", 0.8), ("car", 0.1)),
        detection(("7" * 5000, 0.9)),
        detection(),
        detection(("car", math.nan)),
        detection(("car", 0.9), bbox=box(math.nan, 1, 2, 3)),
        detection(("car", 0.9), bbox=box(1, 1, math.inf, 3)),
        detection(("car", 0.9), bbox=box(1e300, 1, 2, 3)),
        detection(("car", 0.9), bbox=box(1, 1, 2, 3, math.inf)),
        detection(("car", 0.9), bbox=box(1, 1, 0, 3)),
        detection(("car", 0.9), bbox=box(1, 1, 2, -3)),
        detection(("car", 0.9), bbox=box(1e9, 1, 2, 3)),  # in float32 both sides are the same
    )
    assert len(found.boxes) == 1
    assert found.boxes.scores.tolist() == [1.0]
    assert len(decode().boxes) == 0
    assert list(found.unused.items()) == [
        ("box without an area or not finite", 7),
        (f"class '{'7' * 40}' is not configured", 1),
        ("class 'dog' is not configured", 2),
        ("no class with a score", 2),
    ]


@pytest.mark.parametrize("degrees", [0, 30, 90, 135, -60])
def test_turned_box_becomes_its_hull(degrees: int) -> None:
    theta = math.radians(degrees)
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    corners = np.array([[10, 5], [-10, 5], [-10, -5], [10, -5]]) @ turn.T + [30, 40]
    found = decode(detection(("car", 1.0), bbox=box(30, 40, 20, 10, theta)))
    np.testing.assert_allclose(found.boxes.xyxy[0], [*corners.min(0), *corners.max(0)], atol=1e-5)


def test_numbers_as_classes() -> None:
    numbered = [detection(("2", 0.9)), detection(("0", 0.9)), detection(("7", 0.9)), detection(("-1", 0.9))]
    numbered += [detection((sign + "7" * 5000, 0.9)) for sign in ("", "-")]
    unknown = decode(*numbered)
    assert (len(unknown.boxes), sum(unknown.unused.values())) == (0, 6)
    known = decode(*numbered, classes=NUMBERED)
    np.testing.assert_array_equal(known.boxes.class_ids, [0, 1])
    assert [reason[:10] for reason in known.unused] == ["class '-77", "class '7' ", "class '777", "no class w"]


# --- older layouts, from the definitions of their time

ROS1 = {
    "vision_msgs/msg/ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/Detection2D": (
        "Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nsensor_msgs/Image source_img"
    ),
    "vision_msgs/msg/Detection2DArray": "Header header\nDetection2D[] detections",
}
FOXY = {
    "vision_msgs/msg/ObjectHypothesisWithPose": "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/BoundingBox2D": ROS1["vision_msgs/msg/BoundingBox2D"],
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\n"
        "bool is_tracking\nstring tracking_id"
    ),
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
}
GALACTIC = {
    **FOXY,
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": ("ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"),
}


def old_message(definitions: dict[str, str], encoding: builders.Encoding, detections: list[Fields]) -> RawMessage:
    body = {"header": builders.header(STAMP_NS, "camera"), "detections": detections}
    return message_of_layout(MSGTYPE, definitions, encoding, body, topic="/boxes", stamp_ns=STAMP_NS)


OLD_BOX = {"center": {"x": 30.0, "y": 40.0, "theta": math.pi / 2}, "size_x": 20.0, "size_y": 10.0}


@pytest.mark.parametrize(
    ("definitions", "encoding", "result"),
    [
        (ROS1, "ros1", {"id": 2, "score": 0.5}),
        (FOXY, "cdr", {"id": "car", "score": 0.5}),
        (GALACTIC, "cdr", {"hypothesis": {"class_id": "car", "score": 0.5}}),
    ],
)
def test_older_layouts(definitions: dict[str, str], encoding: builders.Encoding, result: Fields) -> None:
    raw = old_message(definitions, encoding, [{"results": [result], "bbox": OLD_BOX}])
    found = decode_detections2d(raw, NUMBERED)
    np.testing.assert_allclose(found.boxes.xyxy, [[25, 30, 35, 50]], atol=1e-5)
    np.testing.assert_array_equal(found.boxes.scores, [0.5])
    np.testing.assert_array_equal(found.boxes.class_ids, [0])
    assert found.ids.tolist() == [""]
