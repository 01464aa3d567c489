import dataclasses
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from pipeline.core.ros.lazy_typestore import lazy_typestore
from pipeline.core.ros.typestores import RosVersion, extra_types

IMAGE = "sensor_msgs/msg/CompressedImage"


def message(store: Typestore, *, is_ros1: bool) -> object:
    new = store.types
    stamp = new["builtin_interfaces/msg/Time"](3, 4)
    seq = {"seq": 7} if is_ros1 else {}
    header = new["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **seq)
    return new[IMAGE](header, "jpeg", np.arange(5, dtype=np.uint8))


@pytest.mark.parametrize("order", [True, False])
def test_cdr_is_that_of_rosbags(order: bool) -> None:
    lazy, eager = lazy_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_HUMBLE)
    data = lazy.serialize_cdr(message(lazy, is_ros1=False), IMAGE, little_endian=order)
    assert data == eager.serialize_cdr(message(eager, is_ros1=False), IMAGE, little_endian=order)
    assert str(lazy.deserialize_cdr(data, IMAGE)) == str(eager.deserialize_cdr(data, IMAGE))


def test_ros1_is_that_of_rosbags() -> None:
    lazy, eager = lazy_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS1_NOETIC)
    data = lazy.serialize_ros1(message(lazy, is_ros1=True), IMAGE)
    assert data == eager.serialize_ros1(message(eager, is_ros1=True), IMAGE)
    assert str(lazy.deserialize_ros1(data, IMAGE)) == str(eager.deserialize_ros1(data, IMAGE))


def test_parts_are_made_once_and_when_they_are_used() -> None:
    store = lazy_typestore(Stores.ROS2_HUMBLE)
    definition = store.get_msgdef(IMAGE)
    assert store.get_msgdef(IMAGE) is definition
    assert "deserialize_cdr_le" not in vars(definition)
    assert definition.deserialize_cdr_le is definition.deserialize_cdr_le
    assert "serialize_cdr_le" not in vars(definition)


def test_conversion_byte_by_byte_is_not_offered() -> None:
    store = lazy_typestore(Stores.ROS1_NOETIC)
    with pytest.raises(AttributeError, match="ros1_to_cdr"):
        store.ros1_to_cdr(b"", IMAGE)


def described(cls: type[Any]) -> object:
    return cls.__name__, cls.__doc__, [(field.name, field.type, field.default) for field in dataclasses.fields(cls)]


@pytest.mark.parametrize("release", [store for store in Stores if store != Stores.LATEST])
def test_all_types_are_those_of_rosbags(release: Stores) -> None:
    lazy, eager = lazy_typestore(release), get_typestore(release)
    assert lazy.fielddefs == eager.fielddefs
    assert [described(cls) for cls in lazy.types.values()] == [described(cls) for cls in eager.types.values()]


@pytest.mark.parametrize("version", [1, 2])
def test_types_that_are_known_are_those_that_are_registered(version: RosVersion) -> None:
    extra = {**extra_types(version)}
    lazy, eager = lazy_typestore(Stores.EMPTY), get_typestore(Stores.EMPTY)
    lazy.know(extra)
    eager.register(extra)
    assert dict(lazy.fielddefs) == eager.fielddefs
    assert {name: described(cls) for name, cls in lazy.types.items()} == {
        name: described(cls) for name, cls in eager.types.items()
    }


@pytest.mark.parametrize(("version", "release"), [(1, Stores.ROS1_NOETIC), (2, Stores.ROS2_HUMBLE)])
def test_what_is_added_is_not_there_already(version: RosVersion, release: Stores) -> None:
    assert not {*extra_types(version)} & {*get_typestore(release).fielddefs}
