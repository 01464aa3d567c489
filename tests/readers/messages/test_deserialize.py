from dataclasses import replace
from typing import Any, Literal

import builders
import numpy as np
import pytest
from builders import detection2d_array, odometry, raw, store_for
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.deserialize import count_items, deserialize, typestore_for

ODOMETRY = "nav_msgs/msg/Odometry"
RULE = "=" * 80
Encoding = Literal["ros1", "cdr"]


def state() -> RawMessage:
    return raw("/odom", ODOMETRY, odometry(stamp_ns=5, position=(1.0, 2.0, 3.0)), 5)


def test_the_recorded_definition_decides_the_layout() -> None:
    odd = Channel("/t", "nav_msgs/msg/Odd", "cdr", "uint16 a\nuint16 b")
    decoded = deserialize(RawMessage(0, 0, (0, 0), b"\0\1\0\0\1\0\2\0", odd))
    assert (decoded.a, decoded.b) == (1, 2)


@pytest.mark.parametrize("distro", ["", "humble", "jazzy", "rosbags"])
def test_without_definitions_common_types_and_vision_msgs_are_known(distro: str) -> None:
    boxes = detection2d_array([[10, 20, 30, 60]], class_names=["car"], scores=[0.5], stamp_ns=5)
    for message in (state(), raw("/boxes", "vision_msgs/msg/Detection2DArray", boxes, 5)):
        for definition in ("", message.channel.definition.split(RULE)[0]):
            bare = message._replace(channel=replace(message.channel, definition=definition, distro=distro))
            assert repr(deserialize(bare)) == repr(deserialize(message))


def test_vision_msgs_of_early_releases_had_another_layout() -> None:
    foxy = Channel("/boxes", "vision_msgs/msg/Detection2DArray", "cdr", "", "ros2msg", "foxy")
    with pytest.raises(MessageError, match="no definition of vision_msgs/msg/Detection2DArray"):
        typestore_for(foxy)


def test_idl_texts_one_after_another() -> None:
    point = "module a_msgs { module msg { struct Point { double x; double y; }; }; };\n"
    path = "module a_msgs { module msg { struct Path { a_msgs::msg::Point first; long count; }; }; };\n"
    text = f"{RULE}\nIDL: a_msgs/msg/Path\n{path}{RULE}\nIDL: a_msgs/msg/Point\n{point}"
    recorded = Channel("/path", "a_msgs/msg/Path", "cdr", text, "ros2idl")
    store = typestore_for(recorded)
    Path, Point = store.types["a_msgs/msg/Path"], store.types["a_msgs/msg/Point"]
    data = bytes(store.serialize_cdr(Path(Point(1.5, 2.5), 3), "a_msgs/msg/Path"))
    decoded = deserialize(RawMessage(0, 0, (0, 0), data, recorded))
    assert (decoded.first.x, decoded.first.y, decoded.count) == (1.5, 2.5, 3)


@pytest.mark.parametrize(
    ("definition", "says"),
    [
        ("int32 = [ 3", "is unusable"),
        ("nowhere_msgs/Thing a", "no definition of nowhere_msgs/msg/Thing, which a_msgs/msg/A needs"),
        ("", "no definition of a_msgs/msg/A"),
    ],
)
def test_unusable_definitions(definition: str, says: str) -> None:
    broken = Channel("/t", "a_msgs/msg/A", "cdr", definition)
    for _ in range(2):  # the second time from the cache
        with pytest.raises(MessageError, match=says) as caught:
            deserialize(RawMessage(0, 0, (0, 0), bytes(8), broken))
        assert str(caught.value).startswith("/t: ")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("before", "after", "other"),
    [
        ("uint32 nanosec\n", "uint32 nanosec\nuint32 more\n", "builtin_interfaces/msg/Time"),
        ("string frame_id\n", "string frame_id  # a name\nuint8 LARGE=1\n", ""),
    ],
)
def test_a_type_of_ros_begins_with_its_header(before: str, after: str, other: str) -> None:
    text = state().channel.definition
    assert before in text
    changed = state()._replace(channel=replace(state().channel, definition=text.replace(before, after)))
    if not other:
        assert deserialize(changed).child_frame_id == "base_link"
        return
    with pytest.raises(MessageError, match=f"^/odom: .* of nav_msgs/msg/Odometry is not ROS's: {other} has other"):
        deserialize(changed)


KNOWN = [
    ("ros1", "cd5e73d190d741a2f92e81eda573aca7"),  # of nav_msgs/Odometry, as rosmsg md5 gives it
    ("cdr", store_for("cdr").hash_rihs01(ODOMETRY)),
]
OTHER = [("ros1", "0" * 32), ("cdr", "RIHS01_" + "0" * 64)]


def digested(encoding: Encoding, digest: str) -> tuple[RawMessage, RawMessage]:
    """A message with a digest and its definition, and the same without the definition."""
    message = raw("/odom", ODOMETRY, odometry(stamp_ns=5), 5, encoding=encoding)
    channel = replace(message.channel, digest=digest)
    return message._replace(channel=channel), message._replace(channel=replace(channel, definition=""))


@pytest.mark.parametrize(("encoding", "digest"), [*KNOWN, ("ros1", "*"), ("cdr", "")])
def test_without_a_definition_the_known_type_has_to_be_the_recorded_one(encoding: Encoding, digest: str) -> None:
    _, bare = digested(encoding, digest)
    assert deserialize(bare).child_frame_id == "base_link"


@pytest.mark.parametrize(("encoding", "digest"), OTHER)
def test_a_definition_goes_before_a_digest(encoding: Encoding, digest: str) -> None:
    message, bare = digested(encoding, digest)
    assert deserialize(message).child_frame_id == "base_link"
    with pytest.raises(MessageError, match=f"no definition of {ODOMETRY}, .* not the recorded {digest}"):
        deserialize(bare)


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_other_serialisations_are_no_ros_messages(encoding: Literal["protobuf", "json"]) -> None:
    message = RawMessage(0, 0, (0, 0), b"{}", Channel("/t", "foxglove.Log", encoding, "", "jsonschema"))
    with pytest.raises(MessageError, match=f"/t: foxglove.Log in {encoding} is not a ROS message"):
        deserialize(message)


def test_a_message_that_could_not_be_read_says_why() -> None:
    with pytest.raises(MessageError, match="/odom: its chunk is gone"):
        deserialize(state()._replace(problem="its chunk is gone"))


# --- strings and messages in lists are counted without making them


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
