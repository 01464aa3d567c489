"""Points of PointCloud and of Livox's CustomMsg; rosbags, which makes an object of each, is the judge."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from builders import Encoding, Fields, header, raw
from message_layouts import message_of_layout
from rig_messages import discover

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.pointcloud import PACKAGES, POINT_CLOUD, decode_livox, decode_pointcloud
from lidcam.readers.messages.registry import decode_as

STAMP_NS = 1_700_000_000_123_456_789
LIVOX = f"{PACKAGES[0]}/msg/CustomMsg"


def plain(count: int, frame: str = "laser", more: int = 0) -> Fields:
    """A PointCloud; one channel has too many values."""
    chance = np.random.default_rng(count)
    points = [dict(zip("xyz", chance.normal(0, 20, 3).tolist(), strict=True)) for _ in range(count)]
    channels = [
        {"name": name, "values": (scale * np.arange(count + longer)).astype(np.float32)}
        for name, scale, longer in (("intensity", 1, 0), ("ring", 2, 0), ("time", 1e-4, 0), ("y", 3, more))
    ]
    return {"header": header(STAMP_NS, frame), "points": points, "channels": channels}


def livox(count: int, frame: str = "livox_frame", *, timebase_ns: int = STAMP_NS) -> Fields:
    """A CustomMsg."""
    chance = np.random.default_rng(0)
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
    numbers = {"timebase": timebase_ns, "point_num": count, "lidar_id": 1}
    return {"header": header(STAMP_NS, frame), **numbers, "points": points}


def message(fields: Fields, msgtype: str = LIVOX, encoding: Encoding = "cdr") -> RawMessage:
    return raw("/lidar", msgtype, fields, STAMP_NS, encoding=encoding)


@pytest.mark.parametrize("msgtype", [POINT_CLOUD, *(f"{package}/msg/CustomMsg" for package in PACKAGES)])
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("count", "frame"), [(0, "livox"), (1, ""), (2, "/a"), (7, "abc"), (5, "livox_frame")])
def test_every_point_is_as_rosbags_reads_it(msgtype: str, encoding: Encoding, count: int, frame: str) -> None:
    one = message(plain(count, frame, 2) if msgtype == POINT_CLOUD else livox(count, frame), msgtype, encoding)
    found, judge = decode_as("cloud", one), deserialize(one)
    assert (found.frame_id, found.stamp_ns, len(found)) == (frame.lstrip("/"), STAMP_NS, count)
    expected = np.array([(p.x, p.y, p.z) for p in judge.points], np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(found.xyz, expected)
    if msgtype == POINT_CLOUD:
        columns = [channel.values for channel in judge.channels]
        intensity, ring, times_ns = columns[0], columns[1], columns[2] * 1e9
    else:
        columns = [[getattr(p, name) for p in judge.points] for name in ("reflectivity", "line", "offset_time")]
        intensity, ring, times_ns = columns
    np.testing.assert_array_equal(found.intensity, intensity)
    np.testing.assert_array_equal(found.ring, ring)
    np.testing.assert_allclose(found.time_offset_ns, times_ns, atol=0 if msgtype != POINT_CLOUD else 1)
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
    found = decode_livox(message(livox(3, timebase_ns=timebase_ns)))
    assert found.time_offset_ns.tolist() == [begin_ns, begin_ns + 4167, begin_ns + 8334]


def test_impossible_times_and_points() -> None:
    fields: Any = livox(3)
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
    fields: Any = livox(4)
    kept = {line.split()[1] for line in point.splitlines()}
    fields["points"] = [{name: value for name, value in one.items() if name in kept} for one in fields["points"]]
    if "lidar_id" not in head:
        del fields["lidar_id"]
    definitions = {"fork/msg/CustomPoint": point, "fork/msg/CustomMsg": f"{head}fork/CustomPoint[] points"}
    of_package = {name.replace("fork", "livox_ros_driver2"): text for name, text in definitions.items()}
    of_package = {name: text.replace("fork", "livox_ros_driver2") for name, text in of_package.items()}
    for encoding in ("ros1", "cdr"):
        one = message_of_layout(
            "livox_ros_driver2/msg/CustomMsg", of_package, encoding, fields, topic="/lidar", stamp_ns=STAMP_NS
        )
        if error:
            with pytest.raises(MessageError, match=error):
                decode_livox(one)
        else:
            assert decode_livox(one).ring.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(("fields", "msgtype"), [(livox(9), LIVOX), (plain(9), POINT_CLOUD)])
def test_messages_that_cannot_be_used(fields: Fields, msgtype: str) -> None:
    one = message(fields, msgtype)
    for end in range(0, len(one.data), 3):
        with pytest.raises(MessageError, match=r"/lidar: "):
            decode_as("cloud", one._replace(data=one.data[:end]))
    with pytest.raises(MessageError, match="9 points, expected at most 5"):
        decode_as("cloud", one, limits=RecordingLimits(max_points=5))
    with pytest.raises(MessageError, match="9 points, and 4 in other clouds of the frame, expected at most 12"):
        decode_as("cloud", one, limits=RecordingLimits(max_frame_points=12), others=4)
    with pytest.raises(MessageError, match=f"expected .*{msgtype}"):
        (decode_livox if msgtype == LIVOX else decode_pointcloud)(raw("/lidar", "sensor_msgs/msg/Image", {}, STAMP_NS))


@pytest.mark.parametrize(("fields", "msgtype"), [(livox(30_000), LIVOX), (plain(30_000), POINT_CLOUD)])
def test_such_a_lidar_is_used_also_without_a_recorded_definition(fields: Fields, msgtype: str) -> None:
    one = message(fields, msgtype)
    bare = one._replace(channel=replace(one.channel, definition=""))
    for recorded in (one, bare):
        found = discover([recorded])
        frame = fields["header"]["frame_id"]
        assert [(lidar.topic, lidar.T_site_lidar.src) for lidar in found.rig.lidars] == [("/lidar", frame)]
        assert len(decode_as("cloud", recorded)) == 30_000
