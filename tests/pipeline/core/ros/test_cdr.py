"""rosbags is the judge of the bytes."""

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from pipeline.core.ros.cdr import CdrEncoder
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.typestores import message_types

STORE = message_types(2)
PACKAGES = (
    "diagnostic_msgs/",
    "foxglove_msgs/",
    "msgs/",
    "sensor_msgs/",
    "tf2_msgs/",
    "vision_msgs/",
    "visualization_msgs/",
)
TYPES = sorted(name for name in STORE.types if name.startswith(PACKAGES))
WHOLE = {"byte", "char", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}


def number(kind: str, rng: np.random.Generator) -> Any:
    if kind == "bool":
        return bool(rng.integers(2))
    if kind in WHOLE:
        info = np.iinfo({"byte": "int8", "char": "uint8"}.get(kind, kind))
        return int(rng.integers(info.min, info.max, endpoint=True, dtype=info.dtype))
    return float(np.dtype(kind).type(rng.normal()))


def value(desc: Any, rng: np.random.Generator, longest: int) -> Any:
    if desc[0] == Nodetype.NAME:
        return made(desc[1], rng, longest)
    if desc[0] == Nodetype.BASE:
        if desc[1][0] == "string":
            return "".join(rng.choice([*"abcä7 "], rng.integers(0, 9)))
        return number(desc[1][0], rng)
    of, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else int(rng.integers(0, longest + 1))
    values = [value(of, rng, longest) for _ in range(count)]
    if of[0] == Nodetype.BASE and of[1][0] != "string":
        return np.array(values, {"byte": "int8", "char": "uint8"}.get(of[1][0], of[1][0]))
    return values


def made(msgtype: str, rng: np.random.Generator, longest: int = 2) -> Any:
    fields = STORE.get_msgdef(msgtype).fields
    return STORE.types[msgtype](*(value(desc, rng, longest) for _, desc in fields))


@pytest.mark.parametrize("msgtype", TYPES)
def test_every_type_that_is_written_has_the_bytes_of_rosbags(msgtype: str) -> None:
    rng = np.random.default_rng(len(msgtype))
    for longest in (0, 1, 2, 3):
        message = made(msgtype, rng, longest)
        assert bytes(ROS2.serialize(message)) == bytes(STORE.serialize_cdr(message, msgtype))


@given(seed=st.integers(0, 2**32), longest=st.integers(0, 4))
def test_any_scene_has_the_bytes_of_rosbags(seed: int, longest: int) -> None:
    message = made("foxglove_msgs/msg/SceneEntity", np.random.default_rng(seed), longest)
    assert bytes(ROS2.serialize(message)) == bytes(STORE.serialize_cdr(message, message.__msgtype__))


def line(points: Any) -> Any:
    """Points behind a text, whose length decides where they begin."""
    color = ROS2.new("foxglove_msgs/msg/Color", 1.0, 0.0, 0.0, 1.0)
    no_colors: Any = np.zeros((0, 4)) if isinstance(points, np.ndarray) else []
    kind = "foxglove_msgs/msg/LinePrimitive"
    return ROS2.new(kind, 1, ROS2.pose((1, 2, 3)), 1.0, True, points, color, no_colors, np.zeros(1, np.uint32))


@pytest.mark.parametrize("count", [0, 1, 7])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_an_array_stands_for_points(count: int, dtype: type[np.floating[Any]]) -> None:
    points = np.random.default_rng(count).normal(size=(count, 3)).astype(dtype)
    as_messages = [ROS2.new("geometry_msgs/msg/Point", *point) for point in points.tolist()]
    assert bytes(ROS2.serialize(line(points))) == bytes(ROS2.serialize(line(as_messages)))


@pytest.mark.parametrize("shape", [(3,), (2, 2), (2, 3, 1)])
def test_arrays_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected \(N, 3\) values"):
        ROS2.serialize(line(np.zeros(shape)))


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(struct.error):
        ROS2.serialize(ROS2.new("builtin_interfaces/msg/Time", -(2**40), 0))
    pose = ROS2.pose_with_covariance(ROS2.pose((0, 0, 0)), np.zeros(35))
    with pytest.raises(ValueError, match="expected 36 values, found 35"):
        ROS2.serialize(pose)


def test_types_are_looked_up_once() -> None:
    asked = []

    def definition(msgtype: str) -> Any:
        asked.append(msgtype)
        return STORE.get_msgdef(msgtype)

    encoder = CdrEncoder(SimpleNamespace(get_msgdef=definition))  # type: ignore[arg-type]  # all that it uses
    for _ in range(3):
        encoder.encode(ROS2.header(5, "site"))
    assert asked == ["std_msgs/msg/Header", "builtin_interfaces/msg/Time"]
