from typing import Any, Literal

import numpy as np
import pytest
from frames import START_NS, image_message
from rosbags.typesys import Stores, get_typestore

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.writers.messages.sensors import cloud_message, image_cdr, read_image

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


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        (
            {"channel": Channel("/c", "std_msgs/msg/String", "cdr")},
            r"expected sensor_msgs/msg/Image or .*, found std_msgs/msg/String",
        ),
        ({"data": b"", "problem": "its part is gone"}, "/c: its part is gone"),
    ],
)
def test_what_is_no_image_says_why(fields: dict[str, Any], error: str) -> None:
    message = image_message("/c", START_NS, frame_id="cam")._replace(**fields)
    with pytest.raises(MessageError, match=error):
        image_cdr(message, frame_id="cam")


STAMP_NS = 1_700_000_000_123_456_789
STORE = get_typestore(Stores.ROS2_HUMBLE)


def cloud(n: int, *, stamp_ns: int = STAMP_NS) -> PointCloud:
    random = np.random.default_rng(n)
    xyz, intensity = random.normal(0, 30, (n, 3)).astype(np.float32), random.random(n, np.float32)
    ring, times_ns = random.integers(0, 128, n).astype(np.uint16), random.integers(-(10**8), 10**8, n).astype(np.int32)
    return PointCloud(stamp_ns, "site", xyz, intensity, ring, times_ns)


def read(points: PointCloud, frame_id: str = "site") -> Any:
    data = ROS2.serialize(cloud_message(points, stamp_ns=STAMP_NS, frame_id=frame_id))
    return STORE.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")


def columns(message: Any) -> dict[str, np.ndarray[Any, Any]]:
    names, kinds, offsets = zip(*((one.name, one.datatype, one.offset) for one in message.fields), strict=True)
    formats = [{7: "<f4", 4: "<u2"}[kind] for kind in kinds]
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step})
    table = np.frombuffer(message.data, layout)
    return {name: table[name] for name in names}


@pytest.mark.parametrize("n", [0, 1, 1000])
@pytest.mark.parametrize("frame_id", ["", "site", "a/very long frame"])
def test_rosbags_reads_the_same_points(n: int, frame_id: str) -> None:
    points = cloud(n)
    message = read(points, frame_id)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (message.header.frame_id, message.height, message.width) == (frame_id, 1, n)
    assert message.row_step == message.point_step * n == len(message.data)
    assert message.is_dense
    assert not message.is_bigendian
    found = columns(message)
    assert list(found) == ["x", "y", "z", "intensity", "ring", "time"]
    np.testing.assert_array_equal(np.stack([found["x"], found["y"], found["z"]], -1), points.xyz)
    np.testing.assert_array_equal(found["intensity"], points.intensity)
    np.testing.assert_array_equal(found["ring"], points.ring)
    np.testing.assert_array_equal(found["time"], (points.time_offset_ns * 1e-9).astype(np.float32))


def test_time_counts_from_the_stamp_of_the_header() -> None:
    points = cloud(5, stamp_ns=STAMP_NS + 250_000_000)
    found = columns(read(points))
    np.testing.assert_array_equal(found["time"], ((points.time_offset_ns + 250e6) * 1e-9).astype(np.float32))
