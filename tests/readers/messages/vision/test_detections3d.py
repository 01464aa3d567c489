import math
from typing import Any

import builders
import numpy as np
import pytest
from builders import Fields
from message_layouts import message_of_layout
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.core.detections import Boxes3D
from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.ros.messages import ROS2
from pipeline.core.settings.recording import LimitsConfig
from readers.messages.vision.detections3d import Detections3D, decode_detections3d
from writers.messages.detections import detections_3d

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "vision_msgs/msg/Detection3DArray"
NAMES = ("car", "pedestrian", "Lkw größer")


def pose(x: float = 1.0, y: float = 2.0, z: float = 3.0, quaternion: tuple[float, ...] = (0, 0, 0, 1)) -> Fields:
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": dict(zip("xyzw", map(float, quaternion), strict=True)),
    }


def detection(
    *classes: tuple[str, float], size: tuple[float, ...] = (4.0, 2.0, 1.5), id_: str = "", **at: Any
) -> Fields:
    return {
        "results": [{"hypothesis": {"class_id": name, "score": score}} for name, score in classes],
        "bbox": {"center": pose(**at), "size": dict(zip("xyz", map(float, size), strict=True))},
        "id": id_,
    }


def message(*detections: Fields) -> RawMessage:
    body = {"header": builders.header(STAMP_NS, "/site"), "detections": list(detections)}
    return builders.raw("/objects", MSGTYPE, body, STAMP_NS)


def decode(*detections: Fields) -> Detections3D:
    return decode_detections3d(message(*detections))


def written(boxes: Boxes3D) -> RawMessage:
    """The message that lidcam's own writer makes of boxes."""
    built = detections_3d(boxes, NAMES, stamp_ns=STAMP_NS)
    channel = Channel("/fused/detections", MSGTYPE, "cdr", ROS2.definition(MSGTYPE))
    return RawMessage(STAMP_NS, STAMP_NS, (0, 0), ROS2.serialize(built), channel)


@pytest.mark.parametrize("count", [0, 1, 30])
def test_what_the_writer_wrote_is_read_back(count: int) -> None:
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, 3, 3))
    yaws = rng.uniform(-np.pi, np.pi, count)
    yaws[:1] = np.pi
    boxes = Boxes3D(
        STAMP_NS,
        "site",
        rng.normal(0, 50, (count, 3)),
        rng.uniform(0.1, 20, (count, 3)),
        yaws,
        rng.random(count, np.float32),
        rng.integers(0, len(NAMES), count).astype(np.int32),
        np.zeros(count, np.int32),
        root @ root.transpose(0, 2, 1),
        np.zeros(count, np.uint8),
        np.full(count, STAMP_NS, np.int64),
    )
    found = decode_detections3d(written(boxes))
    assert (found.stamp_ns, found.frame_id, len(found)) == (STAMP_NS, "site", count)
    for name in ("centers", "sizes", "scores", "covariances"):
        np.testing.assert_allclose(getattr(found, name), getattr(boxes, name), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.yaws, boxes.yaws, atol=1e-12)
    assert found.labels.tolist() == [NAMES[class_id] for class_id in boxes.class_ids]
    assert found.ids.tolist() == [""] * count
    assert (dict(found.counts), dict(found.unused)) == ({}, {})


def test_counts_are_no_classes_and_scores_are_shares() -> None:
    found = decode(
        detection(("lidar_points", 700.0), ("van", 1.0), ("image_pixels/front", 12.0), id_="car1"),
        detection(("car", 0.25), ("bus", 0.75), ("truck", 0.75), ("car", math.nan), id_="x"),
        detection(("lidar_points", 0.0), ("lidar_points", math.inf)),
        detection(("car", 97.0)),
        detection(("car", -0.5)),
    )
    assert found.labels.tolist() == ["van", "bus", "", "car", "car"]
    assert found.ids.tolist() == ["car1", "x", "", "", ""]
    np.testing.assert_array_equal(found.scores, np.array([1.0, 0.75, 0.0, 1.0, 0.0], np.float32))
    np.testing.assert_array_equal(found.counts["lidar_points"], [700, np.nan, 0, np.nan, np.nan])
    np.testing.assert_array_equal(found.counts["image_pixels/front"], [12, *[np.nan] * 4])
    assert sorted(found.counts) == ["image_pixels/front", "lidar_points"]


def test_heading_of_a_turned_and_tilted_box() -> None:
    half = math.radians(130) / 2
    tilt = math.radians(8) / 2
    turned = (0, 0, math.sin(half), math.cos(half))
    # First tilted about its own y axis, then turned about z: the heading stays.
    tilted = (
        -math.sin(half) * math.sin(tilt),
        math.cos(half) * math.sin(tilt),
        math.sin(half) * math.cos(tilt),
        math.cos(half) * math.cos(tilt),
    )
    longer = tuple(3 * part for part in turned)
    opposite = (0, 0, 1, 0)
    found = decode(*(detection(("car", 1), quaternion=each) for each in (turned, tilted, longer, opposite)))
    np.testing.assert_allclose(np.degrees(found.yaws), [130, 130, 130, 180], atol=1e-9)


def test_boxes_that_cannot_be_used_are_counted() -> None:
    upright = math.sqrt(0.5)
    found = decode(
        detection(("car", 1), id_="sound"),
        detection(("car", 1), size=(4, 0, 2)),
        detection(("car", 1), size=(4, -1, 2)),
        detection(("car", 1), size=(4, math.inf, 2)),
        detection(("car", 1), x=math.nan),
        detection(("car", 1), quaternion=(0, 0, 0, 0)),
        detection(("car", 1), quaternion=(0, 0, 0, math.nan)),
        detection(("car", 1), quaternion=(0, upright, 0, upright)),  # its length points up
        detection(("car", 1), quaternion=(0, 0, 1e300, 0)),
    )
    assert found.ids.tolist() == ["sound"]
    assert dict(found.unused) == {"box without a heading": 4, "box without a volume or not finite": 4}


# --- older layouts, from the definitions of their time

POSED = "geometry_msgs/PoseWithCovariance pose"
BOX = "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size"
ROS1 = {
    "vision_msgs/msg/ObjectHypothesisWithPose": f"int64 id\nfloat64 score\n{POSED}",
    "vision_msgs/msg/BoundingBox3D": BOX,
    "vision_msgs/msg/Detection3D": (
        "Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nsensor_msgs/PointCloud2 source_cloud"
    ),
    "vision_msgs/msg/Detection3DArray": "Header header\nDetection3D[] detections",
}
FOXY = {
    "vision_msgs/msg/ObjectHypothesisWithPose": f"string id\nfloat64 score\n{POSED}",
    "vision_msgs/msg/BoundingBox3D": BOX,
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
        "bool is_tracking\nstring tracking_id"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}
HUMBLE = {
    **FOXY,
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": f"ObjectHypothesis hypothesis\n{POSED}",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id"
    ),
}
GALACTIC = {**HUMBLE, "vision_msgs/msg/Detection3D": FOXY["vision_msgs/msg/Detection3D"]}
NO_ID = {
    **HUMBLE,
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox",
}
OWN = {  # fields in another order and of other types: read by its definition
    **HUMBLE,
    "vision_msgs/msg/ObjectHypothesis": "float32 score\nstring class_id",
    "vision_msgs/msg/Detection3D": (
        "string id\nstd_msgs/Header header\nBoundingBox3D bbox\nObjectHypothesisWithPose[] results\nuint8[] more"
    ),
}
NO_BOX = {
    **FOXY,
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results",
}


def old_message(definitions: dict[str, str], encoding: builders.Encoding, detections: list[Fields]) -> RawMessage:
    body = {"header": builders.header(STAMP_NS, "site"), "detections": detections}
    return message_of_layout(MSGTYPE, definitions, encoding, body, topic="/objects", stamp_ns=STAMP_NS)


def of_box(results: list[Fields], **more: Any) -> Fields:
    half = math.radians(30) / 2
    return {
        "header": builders.header(STAMP_NS, "elsewhere"),
        "results": results,
        "bbox": {
            "center": pose(1, 2, 3, (0, 0, math.sin(half), math.cos(half))),
            "size": {"x": 4.0, "y": 2.0, "z": 1.5},
        },
        **more,
    }


COVARIANCE = {"covariance": np.arange(36, dtype=np.float64)}
CLOUD = dict(builders.pointcloud2(np.ones((3, 3), np.float32), stamp_ns=STAMP_NS, ring=np.arange(3, dtype=np.uint16)))

NUMBERED = [{"id": 4, "score": 0.5, "pose": COVARIANCE}]
NAMED = [{"id": "4", "score": 0.5, "pose": COVARIANCE}]
NESTED = [{"hypothesis": {"class_id": "4", "score": 0.5}, "pose": COVARIANCE}]
LAYOUTS: dict[str, tuple[dict[str, str], builders.Encoding, Fields, str]] = {
    "ros1": (ROS1, "ros1", of_box(NUMBERED, source_cloud=CLOUD), ""),
    "foxy": (FOXY, "cdr", of_box(NAMED, tracking_id="a1"), "a1"),
    "galactic": (GALACTIC, "cdr", of_box(NESTED, tracking_id="a1"), "a1"),
    "humble": (HUMBLE, "cdr", of_box(NESTED, id="a1"), "a1"),
    "no_id": (NO_ID, "cdr", of_box(NESTED), ""),
    "own": (OWN, "cdr", of_box(NESTED, id="a1", more=b"abc"), "a1"),
}


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("count", [0, 1, 3])
def test_layouts(name: str, count: int) -> None:
    definitions, encoding, box, id_ = LAYOUTS[name]
    raw = old_message(definitions, encoding, [box] * count)
    found = decode_detections3d(raw)
    assert (found.frame_id, found.labels.tolist(), found.ids.tolist()) == ("site", ["4"] * count, [id_] * count)
    np.testing.assert_array_equal(found.centers, [[1, 2, 3]] * count if count else np.zeros((0, 3)))
    np.testing.assert_array_equal(found.sizes, [[4, 2, 1.5]] * count if count else np.zeros((0, 3)))
    np.testing.assert_allclose(found.yaws, [math.radians(30)] * count)
    np.testing.assert_array_equal(found.scores, [0.5] * count)
    expected = np.arange(36.0).reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_array_equal(found.covariances, np.tile(expected, (count, 1, 1)))


def test_big_endian() -> None:
    definitions, _, box, _ = LAYOUTS["humble"]
    little = old_message(definitions, "cdr", [box])
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(little.channel.definition, MSGTYPE))
    big = store.serialize_cdr(store.deserialize_cdr(little.data, MSGTYPE), MSGTYPE, little_endian=False)
    found = decode_detections3d(little._replace(data=bytes(big)))
    np.testing.assert_array_equal(found.centers, [[1, 2, 3]])
    assert found.labels.tolist() == ["4"]


def test_unknown_layout() -> None:
    raw = old_message(NO_BOX, "cdr", [{"results": [{"id": "car", "score": 0.5}]}])
    with pytest.raises(MessageError, match=r"/objects: .*whose values cannot be used .*bbox"):
        decode_detections3d(raw)


@pytest.mark.parametrize("name", ["ros1", "humble", "own"])
def test_more_boxes_than_a_message_may_hold(name: str) -> None:
    definitions, encoding, box, _ = LAYOUTS[name]
    raw = old_message(definitions, encoding, [box] * 5)
    assert len(decode_detections3d(raw, limits=LimitsConfig(max_boxes=5))) == 5
    with pytest.raises(MessageError, match=r"/objects: 5 boxes, expected at most 4: raise limits.max_boxes"):
        decode_detections3d(raw, limits=LimitsConfig(max_boxes=4))
    for most in (4, 9):
        with pytest.raises(MessageError, match="max_message_items"):
            decode_detections3d(raw, limits=LimitsConfig(max_message_items=most))
