"""rosbags is the judge of the bytes."""

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from any_messages import TYPES, made
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.ros.cdr import CdrEncoder
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.typestores import message_types

STORE = message_types(2)


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
