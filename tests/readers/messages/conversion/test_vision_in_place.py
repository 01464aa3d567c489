"""Boxes moved as bytes, judged by what `vision` builds from decoded messages."""

import struct
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.ros.messages import ROS2, RosMessages
from pipeline.core.settings.classes import ROAD_CLASSES
from readers.messages.conversion.to_ros2 import to_ros2
from readers.messages.conversion.vision import INSTANCE, name_of_number, vision_message
from readers.messages.conversion.vision_in_place import boxes_in_place
from readers.messages.deserialize import deserialize

ROS1 = RosMessages(1)
STAMP_NS = 1_600_000_000_123_456_789
NAME_OF = partial(name_of_number, classes=ROAD_CLASSES)
BOXES_2D, BOXES_3D = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"

texts = st.text(max_size=6)
numbers = st.floats(allow_nan=False, width=64)
hypotheses = st.tuples(st.sampled_from([1, 2, 4, 7, -1, -2, -3, -4, -1002, -9, 2**40]), numbers)
instance_fits = st.tuples(st.just(INSTANCE), st.integers(-1, 10**9).map(float))
boxes = st.lists(st.tuples(texts, st.lists(hypotheses.filter(lambda one: one[0] != -3) | instance_fits, max_size=4)))


def posed(number: int, score: float) -> Any:
    pose = ROS1.pose_with_covariance(ROS1.pose((score, 2, 3)), np.arange(36.0) + score)
    return ROS1.new("vision_msgs/msg/ObjectHypothesisWithPose", id=number, score=score, pose=pose)


def detection_3d(frame: str, results: list[tuple[int, float]]) -> Any:
    center = ROS1.pose((4, 5, 6), (0, 0, 0.6, 0.8))
    return ROS1.new(
        "vision_msgs/msg/Detection3D",
        header=ROS1.header(STAMP_NS, frame),
        results=[posed(*one) for one in results],
        bbox=ROS1.new("vision_msgs/msg/BoundingBox3D", center=center, size=ROS1.vector(4.5, 1.8, 1.5)),
        source_cloud=ROS1.cloud(STAMP_NS, frame, {"x": np.ones(3, np.float32)}),
    )


def detection_2d(frame: str, results: list[tuple[int, float]]) -> Any:
    center = ROS1.new("geometry_msgs/msg/Pose2D", x=10.0, y=20.0, theta=0.5)
    pixels = np.zeros(6, np.uint8)
    return ROS1.new(
        "vision_msgs/msg/Detection2D",
        header=ROS1.header(STAMP_NS, frame),
        results=[posed(*one) for one in results],
        bbox=ROS1.new("vision_msgs/msg/BoundingBox2D", center=center, size_x=3.0, size_y=4.0),
        source_img=ROS1.image(STAMP_NS, frame, height=1, width=2, encoding="rgb8", step=6, data=pixels),
    )


def recorded(frame: str, found: list[tuple[str, list[tuple[int, float]]]], msgtype: str) -> RawMessage:
    make = detection_3d if msgtype == BOXES_3D else detection_2d
    message = ROS1.new(msgtype, header=ROS1.header(STAMP_NS, frame), detections=[make(*one) for one in found])
    channel = Channel("/truth", msgtype, "ros1", ROS1.definition(msgtype), "ros1msg")
    return RawMessage(STAMP_NS, STAMP_NS, (0, 0), bytes(ROS1.serialize(message)), channel)


def built(message: RawMessage) -> bytes:
    """The judge."""
    return bytes(ROS2.serialize(vision_message(deserialize(message), message.channel.msgtype, NAME_OF)))


@pytest.mark.parametrize("msgtype", [BOXES_2D, BOXES_3D])
@given(frame=texts, found=boxes)
def test_the_bytes_are_those_that_are_built(
    msgtype: str, frame: str, found: list[tuple[str, list[tuple[int, float]]]]
) -> None:
    message = recorded(frame, found, msgtype)
    assert boxes_in_place(message, NAME_OF, INSTANCE) == built(message)


@pytest.mark.parametrize("msgtype", [BOXES_2D, BOXES_3D])
@given(data=st.data())
def test_bytes_that_are_changed_or_cut(msgtype: str, data: st.DataObject) -> None:
    whole = bytearray(recorded("map", [("a", [(1, 1.0), (-3, 4.0)]), ("", [])], msgtype).data)
    whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.just(len(whole)) | st.integers(0, len(whole)))
    message = recorded("map", [], msgtype)._replace(data=bytes(whole[:end]))
    found = boxes_in_place(message, NAME_OF, INSTANCE)
    try:
        expected = built(message)
    except MessageError:  # a text among what ROS 2 leaves out may be wrong
        return
    except (ValueError, OverflowError, struct.error):  # an instance, or a time, that is none
        expected = None
    assert found in (expected, None)


@pytest.mark.parametrize("score", [np.nan, np.inf])
def test_an_instance_that_is_no_number_is_refused_as_before(score: float) -> None:
    message = recorded("map", [("a", [(INSTANCE, score)])], BOXES_3D)
    assert boxes_in_place(message, NAME_OF, INSTANCE) is None
    with pytest.raises(MessageError, match="whose values cannot be used"):
        to_ros2(message, NAME_OF)


def test_what_is_of_another_layout_or_of_nobody_is_left() -> None:
    message = recorded("map", [], BOXES_3D)
    assert boxes_in_place(message._replace(data=b""), NAME_OF, INSTANCE) is None
    unknown = message._replace(channel=Channel("/truth", BOXES_3D, "ros1", "uint8 x", "ros1msg"))
    assert boxes_in_place(unknown, NAME_OF, INSTANCE) is None
