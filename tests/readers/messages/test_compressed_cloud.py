"""Compressed clouds: points as in the PointCloud2 that was compressed; Draco, zstd and zlib are the judges."""

import gzip
import zlib
from base64 import b64decode
from typing import Any

import numpy as np
import pytest
import zstandard
from builders import Encoding, pointcloud2, raw
from foxglove_messages import foxglove_raw
from rig_messages import discover
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import CalibrationError, MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages import compressed_cloud
from lidcam.readers.messages.compressed_cloud import decode_compressed_cloud
from lidcam.readers.messages.foxglove import to_ros
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.messages.registry import decode_as

STAMP_NS = 1_700_000_000_123_456_789
TYPE = "point_cloud_interfaces/msg/CompressedPointCloud2"
COUNT = 8
FIELDS = pointcloud2(
    np.arange(3 * COUNT, dtype=np.float32).reshape(-1, 3) / 8,
    stamp_ns=STAMP_NS,
    intensity=10 * np.arange(COUNT, dtype=np.float32),
    t=1000 * np.arange(COUNT, dtype=np.uint32),
    ring=np.arange(COUNT, dtype=np.uint16) % 4,
)
DATA = FIELDS["data"].tobytes()
SEQUENTIAL = b64decode(
    "RFJBQ08CAwAAAIAAAQtkZWR1cGxpY2F0ZQQBAAAAAAgAAAABBgAJAQAAAAkBAAEACQEAAgQJAQADBAYBAAQEBAEABQAAAAABAQAAAAAAAMA+AA"
    "BAPwAAkD8AAMA/AADwPwAAEEAAAChAAAAAPgAAAD8AAGA/AACgPwAA0D8AAABAAAAYQAAAMEAAAIA+AAAgPwAAgD8AALA/AADgPwAACEAAACBA"
    "AAA4QAAAAAAAACBBAACgQQAA8EEAACBCAABIQgAAcEIAAIxCAAEBAAwDAQgjATgDAFCFoA996EMf+tCHPgAAAABYGwAAAAEBAQEDAQgDATgDAF"
    "CFAAAAAAMAAAA="
)
QUANTISED = b64decode(
    "RFJBQ08CAwABAIAAAQtkZWR1cGxpY2F0ZQQBAAAAAAgAAAABBgAJAQAAAAkBAAEACQEAAgQJAQADBAYBAAQEBAEABQMOAAAACAAAAKEFR6Um/m"
    "NQAAAA7rbdtm0rAOD//9+2AYC1/8n////QJ0kkSZIAANtm2yQtACBOJGnbtgD6JMkkSZICq2237dseALgAALRtAAAAAAkAAAD6IEkkSZICAAAA"
    "ACQEAAAAAAAAAAQAAAAAAADIAAAAAAAAKEAOAAAAPgAAKEAOAACAPgAAKEAOAAAAAAAAjEIO"
)
"""The points, by Draco 1.5.7 as draco_publisher.cpp calls it: with its defaults, and with force_quantization."""


def message(format_name: str, data: bytes, encoding: Encoding = "cdr", **changes: Any) -> RawMessage:
    packed = {name: value for name, value in FIELDS.items() if name != "data"}
    packed |= {"compressed_data": np.frombuffer(data, np.uint8), "format": format_name, **changes}
    return raw(f"/points/{format_name}", TYPE, packed, STAMP_NS, encoding=encoding)


def expected() -> PointCloud:
    return decode_pointcloud2(raw("/points", "sensor_msgs/msg/PointCloud2", FIELDS, STAMP_NS))


def same(found: PointCloud, cloud: PointCloud, *, within_m: float = 0) -> None:
    assert (found.frame_id, found.stamp_ns, found.has_time) == (cloud.frame_id, cloud.stamp_ns, cloud.has_time)
    order, in_order = np.argsort(found.time_offset_ns), np.argsort(cloud.time_offset_ns)  # Draco may change it
    np.testing.assert_allclose(found.xyz[order], cloud.xyz[in_order], rtol=0, atol=within_m)
    np.testing.assert_allclose(found.intensity[order], cloud.intensity[in_order], rtol=0, atol=0.01 * (within_m > 0))
    for name in ("ring", "time_offset_ns"):
        np.testing.assert_array_equal(getattr(found, name)[order], getattr(cloud, name)[in_order])


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(
    ("format_name", "data"),
    [("zstd", zstandard.compress(DATA)), ("zlib", gzip.compress(DATA)), ("zlib", zlib.compress(DATA))],
)
def test_zstd_and_zlib(format_name: str, data: bytes, encoding: Encoding) -> None:
    same(decode_as("cloud", message(format_name, data, encoding)), expected())
    organised = message(format_name, data, encoding, height=2, width=COUNT // 2, row_step=len(DATA))
    same(decode_as("cloud", organised), expected())


@pytest.mark.parametrize(("data", "within_m"), [(SEQUENTIAL, 0.0), (QUANTISED, 2e-4)])
def test_draco(data: bytes, within_m: float) -> None:
    pytest.importorskip("DracoPy", reason="DracoPy is not installed: pip install 'lidcam[draco]'")
    same(decode_compressed_cloud(message("draco", data)), expected(), within_m=within_m)


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_a_cloud_of_foxglove_is_moved_by_its_pose(encoding: Any) -> None:
    draco = pytest.importorskip("DracoPy", reason="DracoPy is not installed: pip install 'lidcam[draco]'")
    cloud, turn = expected(), Rotation.from_euler("zyx", [0.7, -0.2, 0.1])
    named = {"intensity": cloud.intensity[:, None], "ring": cloud.ring[:, None]}
    named["t"] = cloud.time_offset_ns.astype(np.uint32)[:, None]
    fields = {
        "timestamp": STAMP_NS,
        "frame_id": "lidar",
        "pose": {"position": {"x": 5.0, "z": -1.0}, "orientation": dict(zip("xyzw", turn.as_quat(), strict=True))},
        "data": draco.encode(cloud.xyz, quantization_bits=0, preserve_order=True, generic_attributes=named),
        "format": "draco",
    }
    packed = to_ros(foxglove_raw("/points", "foxglove.CompressedPointCloud", fields, STAMP_NS + 1, encoding))
    found = decode_compressed_cloud(packed)
    np.testing.assert_allclose(found.xyz, turn.apply(cloud.xyz) + np.array([5, 0, -1]), atol=1e-5)
    for name in ("intensity", "ring", "time_offset_ns", "stamp_ns", "frame_id"):
        np.testing.assert_array_equal(getattr(found, name), getattr(cloud, name))


@pytest.mark.parametrize(
    ("format_name", "data", "words"),
    [
        ("cloudini", DATA, "compressed by 'cloudini', expected draco, zlib or zstd: play .* through"),
        ("zstd", DATA, "that zstd cannot unpack"),
        ("zlib", DATA, "that zlib cannot unpack"),
        ("zstd", zstandard.compress(DATA[:-1]), "do not fit 175 bytes of data"),
        ("zstd", zstandard.compress(bytes(1 << 28)), "unpacks to more bytes, expected 176"),
        ("zlib", zlib.compress(bytes(1 << 20)), "unpacks to more bytes, expected 176"),
        ("draco", DATA, "no usable cloud of Draco .*begin 0000"),
        ("draco", SEQUENTIAL[:40], "head is cut off"),
        ("draco", SEQUENTIAL[:90], "no usable cloud of Draco"),
        ("draco", SEQUENTIAL.replace(b"\x08\0\0\0\1\6", b"\0\0\0\x7f\1\6"), "2130706432 points, expected at most"),
        ("draco", SEQUENTIAL.replace(b"\x09\1\0\0", b"\x09\xff\0\0"), "points of 1038 bytes, expected at most 256"),
    ],
)
def test_damaged_and_hostile_clouds(format_name: str, data: bytes, words: str) -> None:
    if format_name == "draco":
        pytest.importorskip("DracoPy", reason="DracoPy is not installed: pip install 'lidcam[draco]'")
    with pytest.raises(MessageError, match=rf"^/points/{format_name}: .*{words}"):
        decode_compressed_cloud(message(format_name, data))


def test_limits() -> None:
    with pytest.raises(MessageError, match="1 x 8 points, expected at most 5"):
        decode_compressed_cloud(message("zstd", zstandard.compress(DATA)), limits=RecordingLimits(max_points=5))
    with pytest.raises(MessageError, match="in all: raise limit_scale"):
        decode_compressed_cloud(message("zlib", gzip.compress(DATA), row_step=2**31))


def test_without_dracopy_a_lidar_is_left_out_with_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compressed_cloud, "find_spec", lambda _: None)
    other = message("zstd", zstandard.compress(DATA), header={**FIELDS["header"], "frame_id": "other"})
    found = discover([message("draco", SEQUENTIAL), other])
    assert [lidar.topic for lidar in found.rig.lidars] == ["/points/zstd"]
    [fault] = found.faults
    assert "needs DracoPy: pip install 'lidcam[draco]'" in fault.reason


def test_a_compressed_copy_is_not_used() -> None:
    recorded = raw("/points", "sensor_msgs/msg/PointCloud2", FIELDS, STAMP_NS)
    found = discover([message("draco", b"damaged"), recorded])
    assert ([lidar.topic for lidar in found.rig.lidars], found.faults) == (["/points"], ())
    assert "/points/draco: compressed, the same clouds as /points, not used" in found.notes


def test_a_recording_of_which_no_cloud_can_be_decoded_says_why_once() -> None:
    with pytest.raises(CalibrationError) as caught:
        discover([message("cloudini", DATA)])
    assert str(caught.value) == (
        "no lidar is usable in this recording: points_cloudini (/points/cloudini): none of its first 1 messages can be "
        "decoded: a cloud compressed by 'cloudini', expected draco, zlib or zstd: play the recording through "
        "point_cloud_transport's republish and record the PointCloud2"
    )
