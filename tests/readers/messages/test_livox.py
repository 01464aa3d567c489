"""Points of Livox's CustomMsg; rosbags, which makes an object of each, is the judge."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from builders import Encoding, Fields, header, raw
from memory_recording import MemoryRecording
from message_layouts import message_of_layout

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.pointcloud import PACKAGES, decode_livox
from lidcam.readers.messages.registry import decode_as
from lidcam.readers.rig.discovery import discover_rig

STAMP_NS = 1_700_000_000_123_456_789


def content(count: int, frame: str = "livox_frame", *, timebase_ns: int = STAMP_NS, seed: int = 0) -> Fields:
    chance = np.random.default_rng(seed)
    points = [
        {
            "offset_time": index * 4167,
            **dict(zip("xyz", chance.normal(0, 20, 3).tolist(), strict=True)),
            "reflectivity": int(chance.integers(256)),
            "tag": 16,
            "line": index % 6,
        }
        for index in range(count)
    ]
    return {
        "header": header(STAMP_NS, frame),
        "timebase": timebase_ns,
        "point_num": count,
        "lidar_id": 1,
        "points": points,
    }


def message(fields: Fields, package: str = PACKAGES[0], encoding: Encoding = "cdr") -> RawMessage:
    return raw("/livox/lidar", f"{package}/msg/CustomMsg", fields, STAMP_NS, encoding=encoding)


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("count", "frame"), [(0, "livox"), (1, ""), (2, "/a"), (7, "abc"), (5, "livox_frame")])
def test_every_point_is_as_rosbags_reads_it(package: str, encoding: Encoding, count: int, frame: str) -> None:
    one = message(content(count, frame), package, encoding)
    found, judge = decode_as("cloud", one), deserialize(one)
    assert (found.frame_id, found.stamp_ns, len(found)) == (frame.lstrip("/"), STAMP_NS, count)
    expected = np.array([(p.x, p.y, p.z) for p in judge.points], np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(found.xyz, expected)
    np.testing.assert_array_equal(found.intensity, [p.reflectivity for p in judge.points])
    np.testing.assert_array_equal(found.ring, [p.line for p in judge.points])
    np.testing.assert_array_equal(found.time_offset_ns, [p.offset_time for p in judge.points])
    assert found.has_time == (count > 1)  # a single time of 0 says nothing


@pytest.mark.parametrize(
    ("timebase_ns", "begin_ns"),
    [
        (STAMP_NS - 100_000_000, -100_000_000),  # the header has the time of the last point
        (STAMP_NS + 120, 120),  # it was rounded to float64 seconds
        (5_000_000_000, 0),  # the lidar counts from when it was switched on
    ],
)
def test_times_are_those_of_the_header(timebase_ns: int, begin_ns: int) -> None:
    found = decode_livox(message(content(3, timebase_ns=timebase_ns)))
    assert found.time_offset_ns.tolist() == [begin_ns, begin_ns + 4167, begin_ns + 8334]


def test_impossible_times_and_points() -> None:
    fields: Any = content(3)
    fields["points"][1]["offset_time"] = 2**32 - 1
    fields["points"][2]["x"] = float("nan")
    found = decode_livox(message(fields))
    assert (len(found), found.nan_dropped, found.has_time) == (2, 1, False)


POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
MESSAGE = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"


@pytest.mark.parametrize(
    ("point", "head", "error"),
    [
        (POINT, MESSAGE, ""),
        (POINT.replace("uint8 tag\n", ""), MESSAGE, ""),  # a fork's
        (POINT.replace("uint8 line", "uint16 line"), MESSAGE, ""),
        (POINT.replace("float32 x", "float64 x"), MESSAGE, "has a field x that Livox's has not"),
        (POINT.replace("uint32 offset_time\n", ""), MESSAGE, "lacks fields of Livox's"),
        (POINT, MESSAGE.replace("uint8 lidar_id\n", ""), "has other fields than Livox's"),
    ],
)
def test_definitions_of_forks(point: str, head: str, error: str) -> None:
    fields: Any = content(4)
    kept = {line.split()[1] for line in point.splitlines()}
    fields["points"] = [{name: value for name, value in one.items() if name in kept} for one in fields["points"]]
    if "lidar_id" not in head:
        del fields["lidar_id"]
    definitions = {"fork/msg/CustomPoint": point, "fork/msg/CustomMsg": f"{head}fork/CustomPoint[] points"}
    of_package = {name.replace("fork", "livox_ros_driver2"): text for name, text in definitions.items()}
    of_package = {name: text.replace("fork", "livox_ros_driver2") for name, text in of_package.items()}
    for encoding in ("ros1", "cdr"):
        one = message_of_layout(
            "livox_ros_driver2/msg/CustomMsg", of_package, encoding, fields, topic="/livox/lidar", stamp_ns=STAMP_NS
        )
        if error:
            with pytest.raises(MessageError, match=error):
                decode_livox(one)
        else:
            assert decode_livox(one).ring.tolist() == [0, 1, 2, 3]


def test_messages_that_cannot_be_used() -> None:
    one = message(content(9))
    for end in range(0, len(one.data), 7):
        with pytest.raises(MessageError, match=r"/livox/lidar: "):
            decode_livox(one._replace(data=one.data[:end]))
    with pytest.raises(MessageError, match="9 points, expected at most 5"):
        decode_livox(one, limits=RecordingLimits(max_points=5))
    with pytest.raises(MessageError, match="9 points, and 4 in other clouds of the frame, expected at most 12"):
        decode_livox(one, limits=RecordingLimits(max_frame_points=12), others=4)
    with pytest.raises(MessageError, match="expected livox_interfaces"):
        decode_livox(raw("/livox/lidar", "sensor_msgs/msg/Image", {}, STAMP_NS))


def test_a_livox_is_a_lidar_also_without_a_recorded_definition() -> None:
    one = message(content(30_000))
    bare = one._replace(channel=replace(one.channel, definition=""))
    for recorded in (one, bare):
        found = discover_rig(MemoryRecording([recorded]), Config())
        assert [(lidar.name, lidar.T_site_lidar.src) for lidar in found.rig.lidars] == [("livox_lidar", "livox_frame")]
        assert len(decode_livox(recorded)) == 30_000
