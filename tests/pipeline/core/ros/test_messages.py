"""Messages of ROS 2; rosbags judges their bytes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays, from_dtype
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.ros.messages import ROS2, cdr_type
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.native.kernels import CdrType, cdr

MARKER, DETECTION = "visualization_msgs/msg/Marker", "vision_msgs/msg/Detection3D"

DTYPES = {"bool": np.bool_, "byte": np.int8, "char": np.uint8}
"""numpy's types of ROS's kinds of numbers; the others have the same name."""

KINDS = (*DTYPES, *(f"{sign}int{bits}" for sign in ("u", "") for bits in (8, 16, 32, 64)), "float32", "float64")


def values(types: Typestore, kind: Any) -> st.SearchStrategy[Any]:
    """Values of a field, as rosbags defines it."""
    node, detail = kind
    if node == Nodetype.NAME:
        return messages(types, detail)
    if node == Nodetype.BASE:
        return st.text(max_size=5) if detail[0] == "string" else from_dtype(dtype_of(detail[0]))
    (item, what), length = detail
    shortest, longest = (length, length) if node == Nodetype.ARRAY else (0, length or 3)
    if item == Nodetype.BASE and what[0] != "string":
        return st.integers(shortest, longest).flatmap(lambda count: arrays(dtype_of(what[0]), count))
    return st.lists(values(types, (item, what)), min_size=shortest, max_size=longest)


def dtype_of(kind: str) -> np.dtype[Any]:
    return np.dtype(DTYPES.get(kind, kind))


def messages(types: Typestore, msgtype: str) -> st.SearchStrategy[Any]:
    fields = [values(types, kind) for _, kind in types.fielddefs[msgtype][1]]
    return st.tuples(*fields).map(lambda row: types.types[msgtype](*row))


def with_all_kinds() -> Typestore:
    """A type with a value, a sequence and an array of each kind, always after a single byte."""
    kinds = (*KINDS, "string", "Part", "Bytes")
    lengths = {"one": "", "many": "[]", "few": "[<=2]", "three": "[3]"}
    names = [(f"{kind}{length}", f"{name}_{kind.lower()}") for kind in kinds for name, length in lengths.items()]
    fields = [f"uint8 before_{name}\n{kind} {name}" for kind, name in names]
    types = get_types_from_msg("\n".join(["uint8 lambda", *fields]), "all_msgs/msg/All")
    types |= get_types_from_msg("uint8 small\nfloat64 large\nstring name\nuint16 last", "all_msgs/msg/Part")
    store = Typestore()
    store.register(types | get_types_from_msg("float64 first\nuint8[] rest", "all_msgs/msg/Bytes"))
    return store


ALL = with_all_kinds()


@given(messages(ALL, "all_msgs/msg/All"))
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_bytes_are_those_of_rosbags(message: Any) -> None:
    found = cdr(cdr_type(ALL, "all_msgs/msg/All"), message)
    assert found == bytes(ALL.serialize_cdr(message, "all_msgs/msg/All", little_endian=True))


@pytest.mark.parametrize("msgtype", sorted(message_types(2).fielddefs))
@given(st.data())
@settings(max_examples=3, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_bytes_of_known_types_are_those_of_rosbags(msgtype: str, data: st.DataObject) -> None:
    message = data.draw(messages(message_types(2), msgtype))
    assert ROS2.serialize(message) == bytes(message_types(2).serialize_cdr(message, msgtype, little_endian=True))


def test_large_and_strided_arrays_and_other_sequences() -> None:
    data = np.arange(3_000_000, dtype=np.uint32).view(np.uint8)[::3]
    image = ROS2.compressed_image(5, "camera", "jpeg", data)
    assert ROS2.serialize(image) == bytes(message_types(2).serialize_cdr(image, image.__msgtype__))
    transforms = ROS2.new("tf2_msgs/msg/TFMessage", ())
    assert ROS2.serialize(transforms) == b"\0\1" + bytes(6)


@pytest.mark.parametrize(
    ("changed", "error", "told"),
    [
        ({"height": 2**32}, ValueError, "CameraInfo.height: expected a number from 0 to 4294967295, found 4294967296"),
        ({"height": -1}, ValueError, "CameraInfo.height: expected a number from 0 to 4294967295, found -1"),
        ({"height": 1.5}, TypeError, "CameraInfo.height: expected a whole number, found 1.5"),
        ({"distortion_model": 3}, TypeError, "CameraInfo.distortion_model: expected a text, found 3"),
        ({"k": np.zeros(8)}, ValueError, "CameraInfo.k: expected 9 values, found ndarray of float64 (8,)"),
        ({"d": [0.0]}, TypeError, "CameraInfo.d: expected an array of float64, found list of length 1"),
        ({"d": np.zeros(5, np.float32)}, TypeError, "expected an array of float64, found ndarray of float32 (5,)"),
        ({"d": np.zeros(5, ">f8")}, TypeError, "expected an array of float64, found ndarray of >f8 (5,)"),
        ({"d": np.zeros((2, 2))}, TypeError, "expected an array of float64, found ndarray of float64 (2, 2)"),
        ({"header": None}, TypeError, "expected a message std_msgs/msg/Header, found NoneType"),
    ],
)
def test_values_that_do_not_fit_are_refused(changed: dict[str, Any], error: type[Exception], told: str) -> None:
    (info,) = ROS2.rows("sensor_msgs/msg/CameraInfo", 1)
    for name, value in changed.items():
        setattr(info, name, value)
    with pytest.raises(error) as caught:
        ROS2.serialize(info)
    assert str(caught.value).startswith("sensor_msgs/msg/CameraInfo")
    assert str(caught.value).endswith(told)


def test_an_error_names_the_place_in_a_list() -> None:
    (marker,) = ROS2.rows(MARKER, 1)
    marker.points = [ROS2.new("geometry_msgs/msg/Point", 1, 2.0, "3")]
    with pytest.raises(TypeError, match=r"MarkerArray\.markers\[0\]\.points\[0\]\.z: expected a number, found str"):
        ROS2.serialize(ROS2.new("visualization_msgs/msg/MarkerArray", [marker]))
    (color,) = ROS2.rows("std_msgs/msg/ColorRGBA", 1, r=1e39)
    with pytest.raises(ValueError, match=r"ColorRGBA\.r: expected a number that a float32 holds, found 1e\+39"):
        ROS2.serialize(color)
    with pytest.raises(ValueError, match="surrogates not allowed"):
        ROS2.serialize(ROS2.header(0, "\ud800"))
    with pytest.raises(ValueError, match="a_msgs/msg/A: expected a kind of number or a string, found float128"):
        CdrType("a_msgs/msg/A", [("x", "float128", 1)])


@pytest.mark.parametrize("msgtype", [MARKER, DETECTION, "sensor_msgs/msg/CameraInfo", "foxglove_msgs/msg/SceneEntity"])
def test_what_is_left_out_is_zero_or_empty(msgtype: str) -> None:
    (message,) = ROS2.rows(msgtype, 1)
    data = ROS2.serialize(message)
    assert not any(data[4:].replace(b"\1\0\0\0\0", b""))  # an empty text is its length, 1, and its end
    assert ROS2.serialize(ROS2.deserialize(data, msgtype)) == data


def test_a_column_has_a_value_of_each_message_or_one_of_all() -> None:
    found = ROS2.rows("geometry_msgs/msg/Vector3", 2, x=[1.0, 2.0], y=np.array([3.0, 4.0]), z=5.0)
    assert found == [ROS2.vector(1.0, 3.0, 5.0), ROS2.vector(2.0, 4.0, 5.0)]
    assert found[1:] == ROS2.rows_of_numbers("geometry_msgs/msg/Vector3", np.array([[2.0, 4.0, 5.0]]))


@pytest.mark.parametrize(
    ("columns", "error"), [({"x": [1.0]}, ValueError), ({"x": np.zeros(3)}, ValueError), ({"w": 1.0}, LookupError)]
)
def test_a_column_that_does_not_fit_is_refused(columns: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        ROS2.rows("geometry_msgs/msg/Vector3", 2, **columns)
