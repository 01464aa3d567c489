"""Points of sensor_msgs/PointCloud; rosbags, which makes an object of each, is the judge."""

from typing import Any

import numpy as np
import pytest
from builders import Encoding, header, raw
from memory_recording import MemoryRecording

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.pointcloud import POINT_CLOUD, decode_pointcloud
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.rig.discovery import discover_rig

STAMP_NS = 1_700_000_000_123_456_789


def message(count: int = 5, frame: str = "laser", encoding: Encoding = "cdr", more: int = 0) -> RawMessage:
    chance = np.random.default_rng(count)
    points = [dict(zip("xyz", chance.normal(0, 20, 3).tolist(), strict=True)) for _ in range(count)]
    channels = [
        {"name": name, "values": (scale * np.arange(count + longer)).astype(np.float32)}
        for name, scale, longer in (("intensity", 1, 0), ("ring", 2, 0), ("time", 1e-4, 0), ("y", 3, more))
    ]
    fields: Any = {"header": header(STAMP_NS, frame), "points": points, "channels": channels}
    return raw("/cloud", POINT_CLOUD, fields, STAMP_NS, encoding=encoding)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("count", "frame"), [(0, "laser"), (1, ""), (2, "/a"), (7, "abc"), (5, "laser")])
def test_every_point_is_as_rosbags_reads_it(encoding: Encoding, count: int, frame: str) -> None:
    one = message(count, frame, encoding, more=2)
    found, judge = decode_as("cloud", one), deserialize(one)
    assert (found.frame_id, found.stamp_ns, len(found)) == (frame.lstrip("/"), STAMP_NS, count)
    expected = np.array([(p.x, p.y, p.z) for p in judge.points], np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(found.xyz, expected)
    np.testing.assert_array_equal(found.intensity, judge.channels[0].values)
    np.testing.assert_array_equal(found.ring, judge.channels[1].values)
    np.testing.assert_allclose(found.time_offset_ns, judge.channels[2].values * 1e9, atol=1)


def test_damage_and_limits() -> None:
    one = message()
    for end in range(len(one.data)):
        with pytest.raises(MessageError, match=r"/cloud: "):
            decode_pointcloud(one._replace(data=one.data[:end]))
    with pytest.raises(MessageError, match="1 x 5 points, expected at most 4"):
        decode_pointcloud(one, limits=RecordingLimits(max_points=4))
    with pytest.raises(MessageError, match=f"expected {POINT_CLOUD}"):
        decode_pointcloud(raw("/cloud", "sensor_msgs/msg/Image", {}, STAMP_NS))


def test_such_a_lidar_is_used() -> None:
    with MemoryRecording([message(30_000)]) as recording:
        found = discover_rig(recording, Config())
    assert [(lidar.topic, lidar.T_site_lidar.src) for lidar in found.rig.lidars] == [("/cloud", "laser")]
