from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.writers.messages.sensors import cloud_message

STAMP_NS = 1_700_000_000_123_456_789
STORE = get_typestore(Stores.ROS2_HUMBLE)


def cloud(n: int, *, stamp_ns: int = STAMP_NS) -> PointCloud:
    random = np.random.default_rng(n)
    return PointCloud(
        stamp_ns,
        "site",
        random.normal(0, 30, (n, 3)).astype(np.float32),
        random.random(n, np.float32),
        random.integers(0, 128, n).astype(np.uint16),
        random.integers(-(10**8), 10**8, n).astype(np.int32),
    )


def read(points: PointCloud, frame_id: str = "site") -> Any:
    data = ROS2.serialize(cloud_message(points, stamp_ns=STAMP_NS, frame_id=frame_id))
    return STORE.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")


def columns(message: Any) -> dict[str, np.ndarray[Any, Any]]:
    formats = {7: "<f4", 4: "<u2"}
    layout = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [formats[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    table = np.frombuffer(message.data, layout)
    return {name: table[name] for name in layout.names or ()}


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
