"""Two results in one file, read back with the mcap library and rosbags."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from detections import camera_rig, forward_camera
from results import messages_of, topics_of

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.writers.mcap.merged import MergedSide, write_merged
from lidcam.writers.messages.compared import empty_scene
from lidcam.writers.outputs.transaction import OutputFile

RIG = camera_rig(forward_camera())
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def raw(topic: str, message: Any, log_time_ns: int) -> RawMessage:
    msgtype = message.__msgtype__
    channel = Channel(topic, msgtype, "cdr", ROS2.definition(msgtype))
    return RawMessage(log_time_ns, log_time_ns, (0, 0), bytes(ROS2.serialize(message)), channel)


def transforms(topic: str, *pairs: tuple[str, str], log_time_ns: int = 1) -> RawMessage:
    stamped = [ROS2.transform_stamped(0, parent, child, (1.0, 2.0, 3.0), IDENTITY) for parent, child in pairs]
    return raw(topic, ROS2.new("tf2_msgs/msg/TFMessage", stamped), log_time_ns)


def boxes_2d(log_time_ns: int = 1) -> RawMessage:
    header = ROS2.header(5, "cam")
    zero = ROS2.new("vision_msgs/msg/Pose2D", ROS2.new("vision_msgs/msg/Point2D", 1.0, 2.0), 0.0)
    box = ROS2.new("vision_msgs/msg/BoundingBox2D", zero, 3.0, 4.0)
    detection = ROS2.new("vision_msgs/msg/Detection2D", header, [], box, "")
    return raw("/cam/detections", ROS2.new("vision_msgs/msg/Detection2DArray", header, [detection]), log_time_ns)


def objects(log_time_ns: int = 1) -> RawMessage:
    array = ROS2.new("vision_msgs/msg/Detection3DArray", ROS2.header(5, "site"), [])
    return raw("/fused/detections", array, log_time_ns)


def side(name: str, messages: Sequence[RawMessage]) -> MergedSide:
    return MergedSide(name, RIG, [*dict.fromkeys(one.channel for one in messages)], iter(messages))


def merged(path: Path, first: Sequence[RawMessage], second: Sequence[RawMessage], scenes: Sequence[int] = ()) -> Path:
    output = path / "merged.mcap"
    drawn = ((log_time_ns, empty_scene(log_time_ns)) for log_time_ns in scenes)
    sides = [side("a", first), side("b", second)]
    topics = write_merged(OutputFile(output, output), sides, drawn, {"a": "one.mcap", "b": "two.mcap"})
    assert topics == {topic for topic, (_, count) in topics_of(output).items() if count}
    return output


def frames_of(path: Path, topic: str) -> list[list[tuple[str, str]]]:
    return [
        [(one.header.frame_id, one.child_frame_id) for one in message.transforms]
        for _, message in messages_of(path, topic)
    ]


def test_topics_and_frames_of_sensors_have_the_names_of_their_results(tmp_path: Path) -> None:
    messages = [transforms("/tf_static", ("site", "cam"), ("site", "lidar")), boxes_2d(), objects()]
    output = merged(tmp_path, messages, messages, scenes=[1])
    assert topics_of(output) == {
        "/tf_static": ("tf2_msgs/msg/TFMessage", 2),
        "/compare/scene": ("foxglove_msgs/msg/SceneUpdate", 1),
        **{
            f"/{name}{topic}": (f"vision_msgs/msg/{kind}", 1)
            for name in "ab"
            for topic, kind in (("/cam/detections", "Detection2DArray"), ("/fused/detections", "Detection3DArray"))
        },
    }
    assert frames_of(output, "/tf_static") == [
        [("site", "a/cam"), ("site", "a/lidar")],
        [("site", "b/cam"), ("site", "b/lidar")],
    ]
    ((_, found),) = messages_of(output, "/b/cam/detections")
    assert (found.header.frame_id, found.detections[0].header.frame_id) == ("b/cam", "b/cam")
    assert found.detections[0].bbox.size_x == 3.0
    ((_, kept),) = messages_of(output, "/b/fused/detections")
    assert (kept.header.frame_id, kept.header.stamp.nanosec) == ("site", 5)


def test_messages_stand_in_the_order_of_their_times_what_differs_last(tmp_path: Path) -> None:
    output = merged(tmp_path, [objects(1), objects(3)], [objects(2), objects(3)], scenes=[1, 3])
    times = [[time for time, _ in messages_of(output, f"/{name}/fused/detections")] for name in "ab"]
    assert times == [[1, 3], [2, 3]]
    assert [time for time, _ in messages_of(output, "/compare/scene")] == [1, 3]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        pytest.param(True, True, 1, id="the first one's, not the second one's"),
        pytest.param(False, True, 1, id="the second one's where the first one has none"),
        pytest.param(False, False, 0, id="none"),
    ],
)
def test_one_result_says_how_the_site_moves(tmp_path: Path, first: bool, second: bool, expected: int) -> None:
    moving = transforms("/tf", ("odom", "site"))
    one, other = ([moving, objects()] if moves else [objects()] for moves in (first, second))
    output = merged(tmp_path, one, other)
    found = frames_of(output, "/tf") if "/tf" in topics_of(output) else []
    assert found == [[("odom", "site")]] * expected


def test_copied_topics_stay_as_they_are(tmp_path: Path) -> None:
    """Such as truth of ROS 1, below the name of a camera, too."""
    channel = Channel("/cam/detections", "vision_msgs/msg/Detection2DArray", "ros1", "int32 a", "ros1msg", digest="abc")
    message = RawMessage(1, 1, (0, 0), b"\1\2\3\4", channel)
    output = merged(tmp_path, [message], [objects()])
    assert topics_of(output)["/a/cam/detections"] == ("vision_msgs/Detection2DArray", 1)


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        pytest.param(objects()._replace(problem="its chunk is damaged"), "its chunk is damaged", id="by the reader"),
        pytest.param(boxes_2d()._replace(data=b"\0\1\0\0\xff"), "cannot be merged", id="boxes"),
        pytest.param(transforms("/tf")._replace(data=b""), "CDR", id="transforms"),
    ],
)
def test_message_that_cannot_be_read(tmp_path: Path, broken: RawMessage, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        merged(tmp_path, [broken], [objects()])
