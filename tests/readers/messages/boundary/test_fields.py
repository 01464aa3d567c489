"""Definitions that lack what lidcam reads are told once, by topic; those that only differ otherwise are decoded."""

from dataclasses import replace

import numpy as np
import pytest
from builders import camera_info, detection2d_array, image, odometry, pointcloud2, raw, tf_message, transform_stamped
from memory_recording import MemoryRecording

from pipeline.core.errors import MessageError
from pipeline.core.messages import RawMessage
from readers.messages.deserialize import definition_problem, deserialize
from readers.streams.survey import survey

T0 = 10**9
BOXES = detection2d_array([[1, 1, 5, 5]], class_names=["car"], scores=[0.5], stamp_ns=T0)
KINDS = {
    "sensor_msgs/msg/PointCloud2": pointcloud2([[1, 2, 3]], stamp_ns=T0),
    "sensor_msgs/msg/Image": image(np.zeros((2, 2, 3), np.uint8), stamp_ns=T0),
    "sensor_msgs/msg/CameraInfo": camera_info(np.eye(3), stamp_ns=T0, width_px=4, height_px=4),
    "tf2_msgs/msg/TFMessage": tf_message([transform_stamped("a", "b", stamp_ns=T0)]),
    "nav_msgs/msg/Odometry": odometry(stamp_ns=T0),
    "vision_msgs/msg/Detection2DArray": BOXES,
}


def changed(msgtype: str, before: str, after: str, encoding: str = "cdr") -> RawMessage:
    """A message whose definition says something else in one place; the bytes are as they were."""
    message = raw("/t", msgtype, KINDS[msgtype], T0, encoding="ros1" if encoding == "ros1" else "cdr")
    text = message.channel.definition
    assert before in text
    return message._replace(channel=replace(message.channel, definition=text.replace(before, after)))


@pytest.mark.parametrize(
    ("msgtype", "before", "after", "fault"),
    [
        ("sensor_msgs/msg/PointCloud2", "uint32 point_step\n", "", "it has no field point_step"),
        ("sensor_msgs/msg/PointCloud2", "uint32 width", "string width", "its field width is string, expected a whole"),
        ("sensor_msgs/msg/PointCloud2", "uint8[] data", "float32[3] data", "its field data is float32[3], expected ui"),
        ("sensor_msgs/msg/PointCloud2", "uint32 offset", "uint32[] offset", "its field fields[].offset is uint32[], "),
        ("sensor_msgs/msg/PointCloud2", "sensor_msgs/PointField[] f", "sensor_msgs/PointField f", "expected a list"),
        ("sensor_msgs/msg/PointCloud2", "std_msgs/Header header", "string header", "expected a message"),
        ("sensor_msgs/msg/Image", "uint32 step\n", "uint64 step\n", "its fields do not lie as in ROS's sensor_msgs"),
        ("sensor_msgs/msg/CameraInfo", "float64[9] k", "float64[12] k", "its field k is float64[12], expected float64"),
        ("sensor_msgs/msg/CameraInfo", "float64[] d", "string[] d", "its field d is string[], expected float64[]"),
        ("tf2_msgs/msg/TFMessage", "Quaternion rotation\n", "Vector3 rotation\n", "transforms[].transform.rotation.w"),
        ("nav_msgs/msg/Odometry", "string child_frame_id\n", "", "it has no field child_frame_id"),
        ("nav_msgs/msg/Odometry", "string frame_id\n", "string class\n", "it has no field header.frame_id"),
        ("nav_msgs/msg/Odometry", "uint32 nanosec\n", "string nanosec\n", "header.stamp.nanosec is string"),
        (
            "nav_msgs/msg/Odometry",
            "uint32 nanosec\n",
            "uint32 nanosec\nuint32 more\n",
            "not begin with a std_msgs/msg/H",
        ),
        (
            "vision_msgs/msg/Detection2DArray",
            "float64 score\n",
            "string score\n",
            "detections[].results[].hypothesis.sc",
        ),
    ],
)
def test_what_is_missing_is_told(msgtype: str, before: str, after: str, fault: str) -> None:
    message = changed(msgtype, before, after)
    assert fault in definition_problem(message.channel)
    with pytest.raises(MessageError, match=r"^/t: the recorded definition of .* is another than lidcam reads"):
        deserialize(message)
    (found,) = survey(MemoryRecording([message] * 3))
    assert fault in found.problem


@pytest.mark.parametrize(
    ("msgtype", "before", "after"),
    [
        ("sensor_msgs/msg/PointCloud2", "bool is_dense", "bool dense"),
        ("nav_msgs/msg/Odometry", "TwistWithCovariance twist\n", "TwistWithCovariance speed\n"),
        ("sensor_msgs/msg/CameraInfo", "float64[] d", "float64[] D"),
        ("sensor_msgs/msg/Image", "string encoding\n", "string encoding  # see image_encodings\nuint8 LARGE=1\n"),
    ],
)
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_other_differences_do_not_matter(msgtype: str, before: str, after: str, encoding: str) -> None:
    if before == "float64[] d" and encoding == "ros1":
        before, after = after, before
    message = changed(msgtype, before, after, encoding)
    assert not definition_problem(message.channel)
    deserialize(message)


def test_every_known_type_is_what_lidcam_needs() -> None:
    for msgtype, message in KINDS.items():
        for encoding in ("ros1", "cdr"):
            recorded = raw("/t", msgtype, message, T0, encoding="ros1" if encoding == "ros1" else "cdr")
            assert not definition_problem(recorded.channel)
            assert not definition_problem(replace(recorded.channel, definition=""))
