from functools import partial
from typing import Any

import numpy as np
import pytest
from builders import odometry, raw, tf_message, transform_stamped
from rosbags.convert.converter import STATIC_MSGTYPE_RENAMES
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import RosMessages
from lidcam.pipeline.core.ros.typestores import release_types
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior
from lidcam.readers.messages.to_ros2 import RENAMED, _in_ros2, class_name_of_number, name_of_number, to_ros2

ROS1 = RosMessages(1)
STAMP_NS = 1_600_000_000_123_456_789
NAME_OF = partial(name_of_number, classes=ROAD_CLASSES)
BOXES_2D, BOXES_3D = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"


def read(message: RawMessage) -> Any:
    """The message, decoded with nothing but the definition of its channel."""
    assert message.channel.encoding == "cdr"
    assert message.channel.definition_format == "ros2msg"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(message.channel.definition, message.channel.msgtype))
    return store.deserialize_cdr(message.data, message.channel.msgtype)


def ros1(topic: str, message: Any) -> RawMessage:
    msgtype, store = message.__msgtype__, release_types(Stores.ROS1_NOETIC)
    recorded = Channel(topic, msgtype, "ros1", store.generate_msgdef(msgtype)[0], "ros1msg")
    return RawMessage(STAMP_NS, STAMP_NS + 5, (0, 7), bytes(store.serialize_ros1(message, msgtype)), recorded)


def hypothesis(number: int, score: float) -> Any:
    pose = ROS1.pose_with_covariance(ROS1.pose((1, 2, 3)), np.arange(36, dtype=np.float64))
    return ROS1.new("vision_msgs/msg/ObjectHypothesisWithPose", id=number, score=score, pose=pose)


def boxes_3d(*hypotheses: list[Any]) -> Any:
    header = ROS1.header(STAMP_NS, "map")
    center, size = ROS1.pose((4, 5, 6), (0, 0, 0.6, 0.8)), ROS1.vector(4.5, 1.8, 1.5)
    box = ROS1.new("vision_msgs/msg/BoundingBox3D", center=center, size=size)
    detections = [
        ROS1.new(
            "vision_msgs/msg/Detection3D",
            header=header,
            results=results,
            bbox=box,
            source_cloud=ROS1.cloud(STAMP_NS, "map", {"x": np.empty(0, np.float32)}),
        )
        for results in hypotheses
    ]
    return ROS1.new(BOXES_3D, header=header, detections=detections)


def test_cdr_stays_byte_for_byte_with_its_definition() -> None:
    recorded = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=STAMP_NS), STAMP_NS, STAMP_NS + 9)
    assert to_ros2(recorded) == recorded
    assert to_ros2(recorded).data is recorded.data


def test_cdr_without_definition_gets_that_of_its_release() -> None:
    recorded = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=STAMP_NS), STAMP_NS)
    bare = recorded._replace(channel=Channel("/odom", "nav_msgs/msg/Odometry", "cdr"))
    assert read(to_ros2(bare)).child_frame_id == read(recorded).child_frame_id
    assert to_ros2(bare).data is recorded.data


def test_names_of_fields_and_types_that_ros2_changed() -> None:
    lens: dict[str, Any] = {"distortion_model": "plumb_bob", "d": np.arange(5.0), "k": np.arange(9.0)}
    info = ROS1.camera_info(STAMP_NS, "cam", width=4, height=3, **lens)
    found = read(to_ros2(ros1("/info", info)))
    np.testing.assert_array_equal(found.d, np.arange(5.0))
    np.testing.assert_array_equal(found.k, np.arange(9.0))
    np.testing.assert_array_equal(found.r, np.eye(3).reshape(9))
    np.testing.assert_array_equal(found.p, info.P)
    moved = tf_message([transform_stamped("a", "b", stamp_ns=STAMP_NS, translation=(1, 2, 3))])
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage"))
    text, _ = store.generate_msgdef("tf/msg/tfMessage", ros_version=1)
    data = raw("/tf", "tf2_msgs/msg/TFMessage", moved, STAMP_NS, encoding="ros1").data
    old = RawMessage(STAMP_NS, STAMP_NS, (0, 0), data, Channel("/tf", "tf/msg/tfMessage", "ros1", text, "ros1msg"))
    converted = to_ros2(old)
    assert converted.channel.msgtype == "tf2_msgs/msg/TFMessage"
    assert read(converted).transforms[0].transform.translation.z == 3


def test_fields_of_types_that_ros1_does_not_have() -> None:
    point = ROS1.new("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0)
    header = ROS1.header(STAMP_NS, "map")
    markers = ROS1.rows("visualization_msgs/msg/Marker", 1, header=header, text="stop", points=[[point]])
    found = read(to_ros2(ros1("/markers", ROS1.new("visualization_msgs/msg/MarkerArray", markers=markers))))
    (one,) = found.markers
    assert (one.header.frame_id, one.text, one.points[0].z) == ("map", "stop", 3.0)
    assert one.mesh_file.filename == ""


def test_every_type_of_ros1_has_a_definition_in_ros2() -> None:
    store = release_types(Stores.ROS1_NOETIC)
    for msgtype in store.fielddefs:
        definition, _ = store.generate_msgdef(msgtype)
        if definition.strip():
            types, channel, _ = _in_ros2(Channel("/a", msgtype, "ros1", definition, "ros1msg"))
            assert channel.msgtype in types.fielddefs, msgtype


def test_the_types_that_ros2_calls_otherwise_are_those_of_rosbags() -> None:
    assert RENAMED == STATIC_MSGTYPE_RENAMES


def test_types_of_nobody_else_keep_their_own_definition() -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    text = "Header header\nint32 Speed\ntime when\nfloat32[] values\nstring[] names"
    store.register(get_types_from_msg(text, "own_msgs/msg/Thing"))
    recorded, _ = store.generate_msgdef("own_msgs/msg/Thing", ros_version=1)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    thing = types["own_msgs/msg/Thing"](
        header=types["std_msgs/msg/Header"](seq=3, stamp=stamp, frame_id="f"),
        Speed=-4,
        when=stamp,
        values=np.array([1.5], np.float32),
        names=["a", "b"],
    )
    channel_ = Channel("/thing", "own_msgs/msg/Thing", "ros1", recorded, "ros1msg")
    data = bytes(store.serialize_ros1(thing, "own_msgs/msg/Thing"))
    found = read(to_ros2(RawMessage(0, 0, (0, 0), data, channel_)))
    assert (found.header.frame_id, found.Speed, found.when.nanosec, found.names) == ("f", -4, 8, ["a", "b"])
    assert found.values.tolist() == [1.5]


def test_truth_of_ros1_gets_names_and_the_instance_as_id() -> None:
    results = [(1, 1.0), (-1, 55.0), (-2, 70.0), (-3, 4.0), (-1002, 5.0), (-2001, 6.0)]
    results += [(-4, 0.25), (-5, 0.5), (-9, 1.0)]
    found = read(to_ros2(ros1("/truth", boxes_3d([hypothesis(*one) for one in results], [])), NAME_OF))
    first, second = found.detections
    assert {one.hypothesis.class_id: one.hypothesis.score for one in first.results} == {
        "car": 1.0,
        "lidar_points": 55.0,
        "image_pixels": 70.0,
        "lidar_points/2": 5.0,
        "image_pixels/1": 6.0,
        "occlusion": 0.25,
        "truncation": 0.5,
        "-9": 1.0,
    }
    assert (first.id, second.id, second.results) == ("4", "", [])
    assert first.results[0].pose.covariance.tolist() == list(range(36))
    assert (first.bbox.center.position.y, first.bbox.center.orientation.w, first.bbox.size.x) == (5.0, 0.8, 4.5)
    assert found.header.frame_id == "map"
    assert found.header.stamp.nanosec == STAMP_NS % 10**9


def test_2d_boxes_of_ros1() -> None:
    header = ROS1.header(STAMP_NS, "cam")
    image = ROS1.image(STAMP_NS, "cam", height=0, width=0, encoding="", step=0, data=np.zeros(0, np.uint8))
    center = ROS1.new("geometry_msgs/msg/Pose2D", x=10.0, y=20.0, theta=0.5)
    detection = ROS1.new(
        "vision_msgs/msg/Detection2D",
        header=header,
        results=[hypothesis(2, 0.5), hypothesis(-3, -1.0)],
        bbox=ROS1.new("vision_msgs/msg/BoundingBox2D", center=center, size_x=3.0, size_y=4.0),
        source_img=image,
    )
    found = read(to_ros2(ros1("/boxes", ROS1.new(BOXES_2D, header=header, detections=[detection])), NAME_OF))
    (box,) = found.detections
    assert [one.hypothesis.class_id for one in box.results] == ["pedestrian"]
    assert box.id == ""
    assert (box.bbox.center.position.x, box.bbox.center.theta, box.bbox.size_y) == (10.0, 0.5, 4.0)


@pytest.mark.parametrize(
    ("encoding", "problem", "says"),
    [
        ("protobuf", "", "in protobuf is not a ROS message"),
        ("json", "", "in json is not a ROS message"),
        ("cdr", "its chunk is damaged", "/x: its chunk is damaged"),
    ],
)
def test_what_cannot_be_converted(encoding: Any, problem: str, says: str) -> None:
    recorded = RawMessage(0, 0, (0, 0), b"{}", Channel("/x", "foxglove.Grid", encoding), problem=problem)
    with pytest.raises(MessageError, match=says):
        to_ros2(recorded)


def test_names_of_numbers() -> None:
    names = ["car", "pedestrian", "cyclist", "van", "truck", "bus", "7"]
    assert [class_name_of_number(number, ROAD_CLASSES) for number in range(1, 8)] == names
    own = (ClassPrior(name="tram", size_m=(30, 2, 3), max_size_m=(60, 3, 4), labels=("tram", "1", "9")),)
    assert [class_name_of_number(number, own) for number in (1, 2, 9)] == ["tram", "2", "tram"]
