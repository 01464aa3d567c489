from typing import Any, Literal

import numpy as np
import pytest
from frames import START_NS, image_message
from rosbags.typesys import Stores, get_typestore

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.writers.messages.images import image_cdr, read_image

STORE = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ENCODINGS: tuple[Literal["ros1", "cdr"], ...] = ("ros1", "cdr")


def decoded(message: RawMessage) -> Any:
    if message.channel.encoding == "ros1":
        return ROS1.deserialize_ros1(message.data, message.channel.msgtype)
    return STORE.deserialize_cdr(message.data, message.channel.msgtype)


def assert_same_image(found: Any, recorded: Any) -> None:
    for name in set(recorded.__dataclass_fields__) - {"__msgtype__", "header"}:
        np.testing.assert_array_equal(getattr(found, name), getattr(recorded, name))


@pytest.mark.parametrize("frame_id", ["", "c", "cam", "camera_optical"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_fields_and_payload_are_as_recorded(encoding: Literal["ros1", "cdr"], compressed: bool, frame_id: str) -> None:
    message = image_message("/c", START_NS, frame_id="recorded", encoding=encoding, compressed=compressed)
    data = image_cdr(message, frame_id=frame_id)
    found: Any = STORE.deserialize_cdr(data, message.channel.msgtype)
    assert found.header.frame_id == frame_id
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == divmod(START_NS, 10**9)
    assert_same_image(found, decoded(message))
    assert bytes(STORE.serialize_cdr(found, message.channel.msgtype)) == data


def test_big_endian_becomes_little() -> None:
    little = image_message("/c", START_NS, frame_id="cam")
    big = little._replace(data=bytes(STORE.serialize_cdr(decoded(little), little.channel.msgtype, little_endian=False)))
    assert big.data != little.data
    assert image_cdr(big, frame_id="cam") == little.data


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_cut_is_found(encoding: Literal["ros1", "cdr"], compressed: bool) -> None:
    message = image_message("/c", START_NS, frame_id="cam", encoding=encoding, compressed=compressed)
    for length in (*range(60), len(message.data) // 2, len(message.data) - 1):
        with pytest.raises(MessageError, match="/c: "):
            read_image(message._replace(data=message.data[:length]))


def test_another_type_is_refused() -> None:
    message = image_message("/c", START_NS, frame_id="cam")
    other = message._replace(channel=message.channel.__class__("/c", "std_msgs/msg/String", "cdr"))
    with pytest.raises(MessageError, match=r"expected sensor_msgs/msg/Image or .*, found std_msgs/msg/String"):
        read_image(other)


def test_an_image_that_could_not_be_read_says_why() -> None:
    message = image_message("/c", START_NS, frame_id="cam")._replace(data=b"", problem="its part is gone")
    with pytest.raises(MessageError, match="/c: its part is gone"):
        image_cdr(message, frame_id="cam")
