"""rosbags is the judge of the bytes: columns are the fields of messages that it makes and writes."""

import struct
from typing import Any

import numpy as np
import pytest
from any_messages import TYPES, made
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from pipeline.core.ros.column_encoder import ColumnsEncoder
from pipeline.core.ros.columns import Columns, Lists
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.typestores import message_types

STORE = message_types(2)
DTYPES = {"byte": "int8", "char": "uint8"}
ARRAYS_OF_MESSAGES = {"geometry_msgs/msg/Point", "foxglove_msgs/msg/Point2", "foxglove_msgs/msg/Color"}


def all_bytes(columns: Columns) -> list[bytes]:
    """The bytes of each message."""
    (found,) = ROS2.columns.encode(columns)
    return found


def fields_of(msgtype: str) -> Any:
    """Name, kind and what it is of, of each field."""
    return STORE.get_msgdef(msgtype).fields


def columns_of(messages: list[Any], msgtype: str, rng: np.random.Generator) -> Columns:
    """The same messages field by field; what is the same in all of them now and then as one value, or not at all."""
    fields: dict[str, Any] = {}
    for name, (kind, what) in fields_of(msgtype):
        values = [getattr(message, name) for message in messages]
        if kind == Nodetype.BASE:
            fields[name] = values if what[0] == "string" else np.array(values, DTYPES.get(what[0], what[0]))
            if len(values) == 1 and rng.integers(2):
                fields[name] = values[0]
        elif kind == Nodetype.NAME:
            fields[name] = columns_of(values, what, rng)
        elif kind == Nodetype.ARRAY:
            fields[name] = np.array(values).reshape(len(messages), what[1])
            if len(values) == 1 and rng.integers(2):
                fields[name] = tuple(values[0].tolist())
        else:
            fields[name] = lists_of(values, what[0], rng)
        if not any(map(np.size, values)) and rng.integers(2):
            del fields[name]
    return Columns(msgtype, len(messages), **fields)


def lists_of(values: list[Any], of: Any, rng: np.random.Generator) -> Lists:
    counts = [len(one) for one in values]
    items = [item for one in values for item in one]
    if of[0] == Nodetype.BASE:
        return Lists(np.array(items, DTYPES.get(of[1][0], of[1][0])), counts)
    if of[1] in ARRAYS_OF_MESSAGES:
        names = [name for name, _ in STORE.get_msgdef(of[1]).fields]
        return Lists(
            np.array([[getattr(item, name) for name in names] for item in items]).reshape(-1, len(names)), counts
        )
    if len(set(counts)) == 1 and rng.integers(2):
        return Lists(columns_of(items, of[1], rng), counts[0])
    heads = [one[: len(one) // 2] for one in values]
    tails = [one[len(one) // 2 :] for one in values]
    rest = Lists(columns_of([item for one in tails for item in one], of[1], rng), np.array([len(one) for one in tails]))
    first = columns_of([item for one in heads for item in one], of[1], rng)
    return Lists(first, [len(one) for one in heads], rest)


def has_texts_in_lists(msgtype: str) -> bool:
    """Columns have no lists of texts: nothing that is written has any."""
    return any(
        (kind == Nodetype.SEQUENCE and what[0][0] == Nodetype.BASE and what[0][1][0] == "string")
        or (kind == Nodetype.ARRAY and (what[0][0] != Nodetype.BASE or what[0][1][0] == "string"))
        or (kind == Nodetype.NAME and has_texts_in_lists(what))
        or (kind == Nodetype.SEQUENCE and what[0][0] == Nodetype.NAME and has_texts_in_lists(what[0][1]))
        for _, (kind, what) in fields_of(msgtype)
    )


@pytest.mark.parametrize("msgtype", [name for name in TYPES if not has_texts_in_lists(name)])
def test_columns_of_every_type_that_is_written_have_the_bytes_of_rosbags(msgtype: str) -> None:
    rng = np.random.default_rng(len(msgtype))
    for count in (0, 1, 3):
        messages = [made(msgtype, rng) for _ in range(count)]
        expected = [bytes(STORE.serialize_cdr(message, msgtype)) for message in messages]
        assert [bytes(data) for data in all_bytes(columns_of(messages, msgtype, rng))] == expected


@given(seed=st.integers(0, 2**32), longest=st.integers(0, 4), count=st.integers(0, 4))
def test_any_scenes_have_the_bytes_of_rosbags(seed: int, longest: int, count: int) -> None:
    rng, msgtype = np.random.default_rng(seed), "foxglove_msgs/msg/SceneEntity"
    messages = [made(msgtype, rng, longest) for _ in range(count)]
    expected = [bytes(STORE.serialize_cdr(message, msgtype)) for message in messages]
    assert [bytes(data) for data in all_bytes(columns_of(messages, msgtype, rng))] == expected


def test_what_is_left_out_is_zero_or_empty() -> None:
    empty = made("visualization_msgs/msg/Marker", np.random.default_rng(0), 0)
    (data,) = all_bytes(Columns("visualization_msgs/msg/Marker"))
    found: Any = STORE.deserialize_cdr(data, empty.__msgtype__)
    assert len(data) <= len(STORE.serialize_cdr(empty, empty.__msgtype__))
    assert (found.header.frame_id, found.ns, found.id, found.pose.orientation.w, found.points) == ("", "", 0, 0.0, [])


def test_one_value_stands_for_all_rows() -> None:
    header = Columns("std_msgs/msg/Header", frame_id="site")
    poses = Columns("geometry_msgs/msg/PoseStamped", 3, header=header, pose=(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
    first, second, third = all_bytes(poses)
    assert first == second == third
    found: Any = STORE.deserialize_cdr(first, "geometry_msgs/msg/PoseStamped")
    assert (found.header.frame_id, found.pose.position.z, found.pose.orientation.w) == ("site", 3.0, 1.0)


def test_a_message_within_may_be_given_as_its_bytes() -> None:
    stamp, text = struct.pack("<iI", 5, 6), struct.pack("<I", 5) + b"site\0"
    by_bytes = Columns("foxglove_msgs/msg/SceneEntityDeletion", 2, timestamp=stamp, id=["a", "long"])
    by_fields = Columns(
        "foxglove_msgs/msg/SceneEntityDeletion", 2, timestamp=Columns(TIME, sec=5, nanosec=6), id=["a", "long"]
    )
    assert all_bytes(by_bytes) == all_bytes(by_fields)
    header = Columns(HEADER, stamp=stamp, frame_id="site")
    poses = [Columns("geometry_msgs/msg/PoseStamped", header=one) for one in (header, stamp + text)]
    assert all_bytes(poses[0]) == all_bytes(poses[1])


def test_columns_of_several_types_are_encoded_at_once_however_long_they_are() -> None:
    rng = np.random.default_rng(3)
    messages = [made(msgtype, rng, 40) for msgtype in ("visualization_msgs/msg/Marker", HEADER) for _ in range(30)]
    some = [columns_of(messages[:30], messages[0].__msgtype__, rng), columns_of(messages[30:], HEADER, rng)]
    found = ColumnsEncoder(STORE).encode(some[0], Columns(HEADER, 0), some[1])
    assert list(map(len, found)) == [30, 0, 30]
    assert [*found[0], *found[2]] == [bytes(STORE.serialize_cdr(one, one.__msgtype__)) for one in messages]
    assert ColumnsEncoder(STORE).encode() == []


POSE, HEADER, TIME = "geometry_msgs/msg/Pose", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
LINES, STATUS = "foxglove_msgs/msg/LinePrimitive", "diagnostic_msgs/msg/DiagnosticStatus"


@pytest.mark.parametrize(
    ("columns", "error", "told"),
    [
        (
            Columns("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=b""),
            ValueError,
            "bytes depend on what is before",
        ),
        (Columns(HEADER, frames=1), LookupError, "std_msgs/msg/Header has no frames"),
        (Columns(HEADER, 2, frame_id=["a"]), ValueError, "texts: expected 2, found 1"),
        (Columns(HEADER, 2, stamp=Columns(TIME, 3)), ValueError, "expected 2 rows, found 3"),
        (Columns(HEADER, stamp=Columns(HEADER)), ValueError, "expected columns of builtin_interfaces/msg/Time"),
        (Columns(HEADER, stamp=(1, 2)), ValueError, "expected columns"),
        (Columns(POSE, 2, position=np.zeros((2, 4))), ValueError, r"expected \(2, 3\) values"),
        (Columns(POSE, position=(1.0, 2.0)), struct.error, "expected 3 items"),
        (Columns(TIME, sec=2**40), struct.error, "format requires"),
        (Columns(TIME, 1, sec=np.array([2**40])), ValueError, "does not fit into int32"),
        (
            Columns("tf2_msgs/msg/TFMessage", transforms=Lists(Columns(POSE))),
            ValueError,
            "of geometry_msgs",
        ),
        (
            Columns("diagnostic_msgs/msg/DiagnosticArray", status=Lists(Columns(STATUS), 2)),
            ValueError,
            "expected 2 rows, found 1",
        ),
        (
            Columns(LINES, 2, points=Lists(np.zeros((3, 3)), [1, 1])),
            ValueError,
            r"expected \(2, 3\) values",
        ),
        (
            Columns(LINES, 2, indices=Lists(np.zeros(3), [3])),
            ValueError,
            "counts: expected 2",
        ),
    ],
)
def test_what_does_not_fit_is_refused(columns: Columns, error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        all_bytes(columns)
