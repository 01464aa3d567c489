from typing import Any, Literal

import pytest
from builders import channel, header, odometry, raw, store_for, tf_message, transform_stamped
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.messages import Channel
from lidcam.readers.messages.header_stamp import stamp_or_log_time

STAMP = 1_316_000_000_123_456_789
BODIES: dict[str, Any] = {
    "nav_msgs/msg/Odometry": odometry(stamp_ns=STAMP),
    "geometry_msgs/msg/TransformStamped": transform_stamped("a", "b", stamp_ns=STAMP),
    "std_msgs/msg/Header": header(STAMP, "lidar"),
    "tf2_msgs/msg/TFMessage": tf_message([transform_stamped("a", "b", stamp_ns=STAMP)]),
    "std_msgs/msg/String": {"data": "a long enough text to hold a stamp"},
    "std_msgs/msg/Empty": {},
}
WITH_HEADER = {"nav_msgs/msg/Odometry", "geometry_msgs/msg/TransformStamped", "std_msgs/msg/Header"}
ENCODINGS: list[Literal["ros1", "cdr"]] = ["ros1", "cdr"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("msgtype", BODIES)
def test_types_with_and_without_a_header(msgtype: str, encoding: Literal["ros1", "cdr"]) -> None:
    message = raw("/t", msgtype, BODIES[msgtype], STAMP, encoding=encoding)
    expected = STAMP if msgtype in WITH_HEADER else 7
    assert stamp_or_log_time(message.channel, message.data, 7) == expected
    assert stamp_or_log_time(message.channel, memoryview(message.data), 7) == expected
    for size in range(12):
        assert stamp_or_log_time(message.channel, message.data[:size], 7) == 7


@given(sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1), big=st.booleans())
def test_any_stamp_of_either_byte_order_is_that_of_the_full_decoder(sec: int, nanosec: int, big: bool) -> None:
    store = store_for("cdr")
    Header = store.types["std_msgs/msg/Header"]
    Time = store.types["builtin_interfaces/msg/Time"]
    data = bytes(store.serialize_cdr(Header(Time(sec, nanosec), "x"), "std_msgs/msg/Header", little_endian=not big))
    assert stamp_or_log_time(channel("/t", "std_msgs/msg/Header"), data, 7) == sec * 10**9 + nanosec


@pytest.mark.parametrize("definition", ["int32 = 3 = 4 [", "nowhere_msgs/Thing header", "\0"])
def test_unusable_definitions_leave_the_log_time(definition: str) -> None:
    broken = Channel("/t", "a_msgs/msg/A", "cdr", definition)
    assert stamp_or_log_time(broken, bytes(100), 7) == 7
