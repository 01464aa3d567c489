"""Foxglove's schemas give the same typed data as the ROS types."""

from typing import Any, Literal

import cv2
import numpy as np
import pytest
from builders import camera_info, header, image, pointcloud2, raw, tf_message, transform_stamped
from foxglove_messages import foxglove_raw, twin
from helpers import at_most
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.camera_info import camera_model
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.foxglove import _message_class, _read_fields, to_ros
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.messages.tf import decode_transforms

STAMP = 1_700_000_000_123_456_789
LOGGED = STAMP + 50_000_000
K = np.array([[500.0, 0, 32.25], [0, 501.0, 24.5], [0, 0, 1]])

Encoding = Literal["protobuf", "json"]
both = pytest.mark.parametrize("encoding", ["protobuf", "json"])


def points(count: int) -> F64:
    return np.random.default_rng(4).normal(scale=20, size=(count, 3))


def cloud(count: int = 100, dtype: type[Any] = np.float32) -> RawMessage:
    rng = np.random.default_rng(5)
    fields = pointcloud2(
        points(count).astype(dtype),
        stamp_ns=STAMP,
        intensity=rng.uniform(0, 255, count).astype(np.float32),
        ring=rng.integers(0, 16, count).astype(np.uint16),
        time=rng.uniform(0, 0.1, count).astype(np.float32),
        point_padding=2,
    )
    return raw("/points", "sensor_msgs/msg/PointCloud2", fields, STAMP, LOGGED)


def image_message(encoding: str = "rgb8") -> RawMessage:
    pixels = np.random.default_rng(6).integers(0, 256, (48, 64, 3), np.uint8)
    pixels = pixels if encoding == "rgb8" else pixels[..., 0]
    fields = image(pixels, stamp_ns=STAMP, encoding=encoding, row_padding=8)
    return raw("/image", "sensor_msgs/msg/Image", fields, STAMP)


def compressed(kind: str) -> RawMessage:
    pixels = np.random.default_rng(7).integers(0, 256, (48, 64, 3), np.uint8)
    data = cv2.imencode(f".{kind}", pixels)[1].reshape(-1)
    fields = {"header": header(STAMP, "camera"), "format": kind, "data": data}
    return raw("/image", "sensor_msgs/msg/CompressedImage", fields, STAMP)


@both
@pytest.mark.parametrize(("count", "dtype"), [(0, np.float32), (100, np.float32), (100, np.float64)])
def test_clouds(encoding: Encoding, count: int, dtype: type[Any]) -> None:
    message = cloud(count, dtype)
    expected, found = decode_pointcloud2(message), decode_pointcloud2(to_ros(twin(message, encoding)))
    assert (found.stamp_ns, found.frame_id, found.has_time) == (STAMP, "lidar", expected.has_time)
    for name in ("xyz", "intensity", "ring", "time_offset_ns"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@both
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_are_given_relative_to_the_pose(encoding: Encoding, dtype: type[Any]) -> None:
    turn = Rotation.from_euler("zyx", [0.7, -0.2, 0.1])
    data = np.vstack([points(50), [[np.nan, 0, 0]]]).astype(dtype)
    fields = {
        "timestamp": STAMP,
        "pose": {"position": {"x": 5.0, "z": -1.0}, "orientation": dict(zip("xyzw", turn.as_quat(), strict=True))},
        "point_stride": 3 * data.itemsize,
        "fields": [
            {"name": n, "offset": i * data.itemsize, "type": 7 + (dtype is np.float64)} for i, n in enumerate("xyz")
        ],
        "data": data.tobytes(),
    }
    found = decode_pointcloud2(to_ros(foxglove_raw("/points", "foxglove.PointCloud", fields, LOGGED, encoding)))
    assert found.nan_dropped == 1
    assert np.allclose(found.xyz, turn.apply(data[:-1]) + np.array([5, 0, -1]), atol=1e-4)


@both
@pytest.mark.parametrize(
    "message", [image_message(), image_message("mono8"), image_message("bayer_rggb8"), *map(compressed, ("png", "jpg"))]
)
def test_images(encoding: Encoding, message: RawMessage) -> None:
    found = decode_any_image(to_ros(twin(message, encoding)))
    expected = decode_any_image(message)
    assert (found.stamp_ns, found.frame_id) == (STAMP, "camera")
    assert np.array_equal(found.rgb, expected.rgb)


@both
def test_calibration(encoding: Encoding) -> None:
    options: dict[str, Any] = {"width_px": 64, "height_px": 48, "distortion": (0.1, -0.2, 1e-3, 2e-3, 0.05)}
    message = raw("/info", "sensor_msgs/msg/CameraInfo", camera_info(K, stamp_ns=STAMP, **options), STAMP)
    expected, found = (camera_model(deserialize(m)) for m in (message, to_ros(twin(message, encoding))))
    assert (found.frame_id, found.width_px, found.height_px, found.model) == ("camera", 64, 48, "plumb_bob")
    assert np.array_equal(found.K, expected.K)
    assert np.array_equal(found.distortion, expected.distortion)


@both
def test_a_calibration_needs_neither_r_nor_p(encoding: Encoding) -> None:
    fields = {"timestamp": STAMP, "width": 64, "height": 48, "K": K.reshape(-1).tolist()}
    info = deserialize(to_ros(foxglove_raw("/info", "foxglove.CameraCalibration", fields, LOGGED, encoding)))
    assert np.array_equal(camera_model(info).K, K)
    assert np.array_equal(info.r.reshape(3, 3), np.eye(3))


@both
def test_transforms(encoding: Encoding) -> None:
    turn = (0.5, -0.5, 0.5, -0.5)
    edges = [
        transform_stamped("base", name, stamp_ns=STAMP + i, translation=(i, 2.5, -3), rotation_xyzw=turn)
        for i, name in enumerate(["a", "b"])
    ]
    message = raw("/tf", "tf2_msgs/msg/TFMessage", tf_message(edges), LOGGED)
    several = to_ros(twin(message, encoding))
    assert several.stamp_ns == LOGGED
    fields = {
        "timestamp": STAMP,
        "parent_frame_id": "base",
        "child_frame_id": "a",
        "translation": {"y": 2.5, "z": -3.0},
        "rotation": dict(zip("xyzw", turn, strict=True)),
    }
    single = to_ros(foxglove_raw("/tf", "foxglove.FrameTransform", fields, LOGGED, encoding))
    assert _matrices(several) == _matrices(message)
    assert _matrices(single) == _matrices(message)[:1]


def _matrices(message: RawMessage) -> list[Any]:
    return [(stamp, t.dst, child, t.matrix.tolist()) for stamp, t, child in decode_transforms(message)]  # type: ignore[union-attr]  # none is at fault here


@both
@given(stamp_ns=st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_are_exact(encoding: Encoding, stamp_ns: int) -> None:
    fields = {"timestamp": stamp_ns, "format": "png"}
    found = to_ros(foxglove_raw("/image", "foxglove.CompressedImage", fields, LOGGED, encoding))
    assert (found.stamp_ns, found.problem) == (stamp_ns, "")
    stamp = deserialize(found).header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == stamp_ns
    without = to_ros(foxglove_raw("/image", "foxglove.CompressedImage", {}, LOGGED, encoding))
    assert without.stamp_ns == LOGGED


XYZ = [{"name": n, "offset": 4 * i, "type": 7} for i, n in enumerate("xyz")]
TWO_POINTS = {"point_stride": 12, "fields": XYZ, "pose": {"orientation": {"z": 1.0}}, "data": bytes(24)}


@both
@pytest.mark.parametrize(
    ("schema", "fields", "says"),
    [
        ("PointCloud", {**TWO_POINTS, "data": bytes(30)}, "30 bytes of data are not whole points of 12"),
        ("PointCloud", {"point_stride": 4, "fields": [{"name": "x", "type": 9}], "data": bytes(4)}, "has type 9"),
        ("PointCloud", {**TWO_POINTS, "fields": XYZ[:2]}, "fields x, y and z"),
        ("PointCloud", {**TWO_POINTS, "fields": [{**f, "type": 6} for f in XYZ]}, "expected float"),
        ("PointCloud", {**TWO_POINTS, "pose": {"orientation": {"w": float("nan")}}}, "quaternion"),
        ("CameraCalibration", {"K": [1.0, 2.0]}, "K has 2 numbers, expected 9"),
        ("CompressedImage", {"timestamp": 2**31 * 10**9}, "stamp.sec: expected a number from -2147483648 to 2147"),
    ],
)
def test_messages_that_contradict_themselves(encoding: Encoding, schema: str, fields: Any, says: str) -> None:
    message = to_ros(foxglove_raw("/t", f"foxglove.{schema}", fields, LOGGED, encoding))
    with pytest.raises(MessageError, match=says) as caught:
        deserialize(message)
    assert str(caught.value).startswith("/t: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "JSONDecodeError"),
        (b'{"format": "\xff"}', "UnicodeDecodeError"),
        (b"[1]", "expected a JSON object, found list"),
        (b'{"data": 7}', r"json \(data: expected a text, found 7\)"),
        (b'{"data": "%%%"}', "expected base64, found '%%%'"),
        (b'{"timestamp": 5}', "timestamp: expected an object, found 5"),
        (b'{"timestamp": {"sec": []}}', r"sec: expected a number, found \[\]"),
        (b'{"format": ["png"]}', "format: expected a text, found \\['png'\\]"),
        (b"[" * 100_000, "limit_scale"),
    ],
)
def test_json_of_something_else(data: bytes, says: str) -> None:
    message = foxglove_raw("/image", "foxglove.CompressedImage", {}, LOGGED, "json")._replace(data=data)
    with pytest.raises(MessageError, match=says):
        deserialize(to_ros(message))


def test_a_null_is_an_unset_field() -> None:
    message = foxglove_raw("/image", "foxglove.CompressedImage", {}, LOGGED, "json")
    found = to_ros(message._replace(data=b'{"timestamp": null, "format": "png", "data": null}'))
    assert (found.stamp_ns, deserialize(found).format) == (LOGGED, "png")


def test_zeros_are_no_rotation() -> None:
    """A writer that leaves the orientation of proto3 at its default means none."""
    fields = {"timestamp": STAMP, "pose": {"orientation": {}}, "point_stride": 12, "fields": XYZ}
    data = points(5).astype(np.float32)
    cloud_at_origin = foxglove_raw("/points", "foxglove.PointCloud", {**fields, "data": data.tobytes()}, LOGGED)
    assert np.array_equal(decode_pointcloud2(to_ros(cloud_at_origin)).xyz, data)


def transforms_of(count: int, encoding: Encoding) -> RawMessage:
    links = [transform_stamped("a", f"b{i}", stamp_ns=5) for i in range(count)]
    return twin(raw("/tf", "tf2_msgs/msg/TFMessage", tf_message(links), 5), encoding)


@both
def test_more_values_than_a_message_may_hold(encoding: Encoding) -> None:
    message = transforms_of(100, encoding)
    assert len(_read_fields(message, limits=RecordingLimits(max_message_items=2000))["transforms"]) == 100
    with pytest.raises(MessageError, match=r"more than 99 values: raise limit_scale"):
        _read_fields(message, limits=RecordingLimits(max_message_items=99))


def test_a_small_message_that_would_be_large_once_it_is_read() -> None:
    template = transforms_of(1, "protobuf")
    info = camera_info(np.eye(3), stamp_ns=1, width_px=1, height_px=1)
    calibration = twin(raw("/i", "sensor_msgs/msg/CameraInfo", info, 1), "protobuf")
    kind: Any = _message_class(calibration.channel)
    fields = kind.DESCRIPTOR.fields_by_name
    packed = bytes([fields["D"].number << 3 | 2]) + b"\x80\x80\x40" + bytes(1 << 20)
    empty_transforms = template._replace(data=b"\x0a\x00" * 3_000_000)
    for message in (empty_transforms, calibration._replace(data=packed)):
        with at_most(20), pytest.raises(MessageError, match=r"limit_scale"):
            _read_fields(message)
