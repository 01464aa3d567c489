"""Strings and messages in lists are counted without making them."""

from typing import Any

import builders
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.deserialize import count_items, deserialize, typestore_for

RULE = "=" * 80
DEFINITION = (
    "uint8 a\nstring[] names\nPart[] parts\nfloat64 b\nPart[2] pair\nint16[3] three\nfloat64[] numbers\nbool c\n"
    f"{RULE}\nMSG: a/Part\nuint8 kind\nfloat64 weight\nstring name\nLeaf[] leaves\nint64[] longs\n"
    f"{RULE}\nMSG: a/Leaf\nuint16 x\n"
)


def message_of(names: list[str], parts: list[tuple[str, int, int]], numbers: int, encoding: Any) -> RawMessage:
    form: Any = "ros1msg" if encoding == "ros1" else "ros2msg"
    channel = Channel("/a", "a/msg/A", encoding, DEFINITION, form)
    store = typestore_for(channel)
    leaf, part = store.types["a/msg/Leaf"], store.types["a/msg/Part"]
    built = [
        part(kind=1, weight=2.0, name=name, leaves=[leaf(x=3)] * leaves, longs=np.zeros(longs, np.int64))
        for name, leaves, longs in parts
    ]
    empty = part(kind=0, weight=0.0, name="", leaves=[], longs=np.zeros(0, np.int64))
    whole = store.types["a/msg/A"](
        a=1,
        names=names,
        parts=built,
        b=0.0,
        pair=[empty, empty],
        three=np.zeros(3, np.int16),
        numbers=np.zeros(numbers),
        c=True,
    )
    serialize = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    return RawMessage(0, 0, (0, 0), bytes(serialize(whole, "a/msg/A")), channel)


@given(
    names=st.lists(st.text(max_size=5), max_size=4),
    parts=st.lists(st.tuples(st.text("ab", max_size=5), st.integers(0, 3), st.integers(0, 3)), max_size=4),
    numbers=st.integers(0, 3),
    encoding=st.sampled_from(["ros1", "cdr"]),
)
def test_every_part_is_passed(names: list[str], parts: list[tuple[str, int, int]], numbers: int, encoding: str) -> None:
    message = message_of(names, parts, numbers, encoding)
    store = typestore_for(message.channel)
    expected = len(names) + len(parts) + sum(leaves for _, leaves, _ in parts)
    assert count_items(store, "a/msg/A", encoding, message.data, 1000) == expected
    assert count_items(store, "a/msg/A", encoding, message.data[: len(message.data) // 2], 1000) <= expected


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_more_than_memory_holds(encoding: Any) -> None:
    form: Any = "ros1msg" if encoding == "ros1" else "ros2msg"
    text = f"Leaf[] leaves\n{RULE}\nMSG: a/Leaf\nuint8 x\n"
    head = b"\0\1\0\0" if encoding == "cdr" else b""
    data = head + (2_000_000).to_bytes(4, "little") + bytes(2_000_000)
    message = RawMessage(0, 0, (0, 0), data, Channel("/a", "a/msg/A", encoding, text, form))
    with pytest.raises(MessageError, match="a a/msg/A with more than 20000 strings or messages in its lists: raise "):
        deserialize(message)


def test_a_large_cloud_has_few() -> None:
    body = builders.pointcloud2(np.zeros((100_000, 3), np.float32), stamp_ns=0)
    message = builders.raw("/points", "sensor_msgs/msg/PointCloud2", body, 0)
    assert len(deserialize(message).data) == 1_200_000
    assert count_items(typestore_for(message.channel), message.channel.msgtype, "cdr", message.data, 10) == 3
