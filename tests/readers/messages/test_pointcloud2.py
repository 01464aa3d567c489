import logging
from typing import Any

import builders
import numpy as np
import numpy.typing as npt
import pytest
from builders import POINT_FIELD_DATATYPES, Fields
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import I32, Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.pointcloud2 import MAX_OFFSET_NS, decode_pointcloud2, point_time_offsets

STAMP_NS = 1_700_000_000_123_456_789
XYZ = np.array([[1, 2, 3], [-4, 5.5, 6], [7, 8, -9]], np.float32)
MSGTYPE = "sensor_msgs/msg/PointCloud2"


def message(fields: Fields, encoding: builders.Encoding = "cdr") -> RawMessage:
    return builders.raw("/points", MSGTYPE, fields, STAMP_NS, encoding=encoding)


def decode(xyz: npt.ArrayLike = XYZ, **options: Any) -> PointCloud:
    return decode_pointcloud2(message(builders.pointcloud2(xyz, stamp_ns=STAMP_NS, **options)))


def changed(**changes: Any) -> RawMessage:
    return message({**builders.pointcloud2(XYZ, stamp_ns=STAMP_NS), **changes})


# --- layouts


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_plain_cloud(encoding: builders.Encoding) -> None:
    fields = builders.pointcloud2(XYZ, stamp_ns=STAMP_NS, frame_id="/velodyne")
    cloud = decode_pointcloud2(message(fields, encoding))
    np.testing.assert_array_equal(cloud.xyz, XYZ)
    assert (cloud.stamp_ns, cloud.frame_id, cloud.nan_dropped, cloud.has_time) == (STAMP_NS, "velodyne", 0, False)
    assert not cloud.intensity.any()
    assert not cloud.ring.any()
    assert not cloud.time_offset_ns.any()


POINT_DTYPES = {**POINT_FIELD_DATATYPES, "i8": 9, "u8": 10}


@st.composite
def layouts(draw: st.DrawFn) -> tuple[Fields, Array]:
    """A message with fields in any order, datatype, gap and byte order, and the structured array it was made of."""
    is_bigendian = draw(st.booleans())
    height, width = draw(st.sampled_from([(1, 0), (1, 1), (1, 7), (3, 4), (5, 1), (0, 3)]))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring", "rgb", "normal"]))
    formats, offsets, fields, at = [], [], [], 0
    for name in names:
        code = draw(st.sampled_from(sorted(POINT_DTYPES)))
        count = 3 if name == "normal" else draw(st.sampled_from([0, 1, 2]))
        at += draw(st.integers(0, 5))
        base = np.dtype((">" if is_bigendian else "<") + code)
        formats.append((base, (max(count, 1),)))
        offsets.append(at)
        fields.append({"name": name, "offset": at, "datatype": POINT_DTYPES[code], "count": count})
        at += base.itemsize * max(count, 1)
    point_step = at + draw(st.integers(0, 7))
    layout: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    table = np.zeros((height, width), np.dtype(layout))
    for name in names:
        table[name] = rng.integers(0, 100, table[name].shape)
    gap = draw(st.integers(0, 9))
    rows = np.frombuffer(table.tobytes(), np.uint8).reshape(height, width * point_step)
    data = np.pad(rows, ((0, 0), (0, gap)), constant_values=0xAB).reshape(-1)
    body = {
        "header": builders.header(STAMP_NS, "lidar"),
        "height": height,
        "width": width,
        "fields": fields,
        "is_bigendian": is_bigendian,
        "point_step": point_step,
        "row_step": width * point_step + gap,
        "data": data[: len(data) - draw(st.integers(0, gap if height else 0))],
    }
    return body, table.reshape(-1)


@given(layouts())
def test_any_layout_reads_as_numpy_reads_it(case: tuple[Fields, Array]) -> None:
    body, table = case
    cloud = decode_pointcloud2(message(body))
    expected = np.stack([table[axis][:, 0] for axis in "xyz"], -1).astype(np.float32)
    np.testing.assert_array_equal(cloud.xyz, expected)
    np.testing.assert_array_equal(cloud.intensity, table["intensity"][:, 0].astype(np.float32))
    np.testing.assert_array_equal(cloud.ring, table["ring"][:, 0].astype(np.uint16))
    assert cloud.nan_dropped == 0


@pytest.mark.parametrize("row_step", [0, 3, 12, 36])
def test_rows_without_gaps_need_no_step(row_step: int) -> None:
    np.testing.assert_array_equal(decode_pointcloud2(changed(height=3, width=1, row_step=row_step)).xyz, XYZ)


def test_no_points_and_no_finite_ones() -> None:
    cloud = decode_pointcloud2(message({"header": builders.header(STAMP_NS, "lidar")}))
    assert (len(cloud), cloud.nan_dropped) == (0, 0)
    cloud = decode(np.full((5, 3), np.nan, np.float32), time=np.ones(5, np.float32))
    assert (len(cloud), cloud.nan_dropped, cloud.has_time) == (0, 5, False)


# --- points without a place


@pytest.mark.parametrize(("hole", "axis"), [(np.nan, 0), (np.inf, 1), (-np.inf, 2), (1e38, 0)])
def test_points_without_a_place_are_dropped_with_all_their_fields(hole: float, axis: int) -> None:
    xyz = XYZ.copy()
    xyz[1, axis] = hole
    cloud = decode(
        xyz,
        intensity=np.array([1, 2, 3], np.float32),
        ring=np.array([4, 5, 6], np.uint8),
        t=np.array([7, 4_000_000_000, 9], np.uint32),  # a time that makes no sense, on a point that has no place
    )
    np.testing.assert_array_equal(cloud.xyz, XYZ[[0, 2]])
    np.testing.assert_array_equal(cloud.intensity, [1, 3])
    np.testing.assert_array_equal(cloud.ring, [4, 6])
    np.testing.assert_array_equal(cloud.time_offset_ns, [7, 9])
    assert (cloud.nan_dropped, cloud.has_time) == (1, True)


def test_float64_keeps_what_float32_can_hold() -> None:
    cloud = decode(np.array([[0.1, 5_000_000.3, 1e300], [0.1, 5_000_000.3, 1.0]]))
    np.testing.assert_array_equal(cloud.xyz, np.array([[0.1, 5_000_000.3, 1.0]], np.float32))
    assert cloud.nan_dropped == 1


# --- other fields


@pytest.mark.parametrize(
    ("name", "code"), [("intensity", "f4"), ("i", "f8"), ("reflectivity", "u1"), ("signal", "u2"), ("Intensity", "f4")]
)
def test_intensity(name: str, code: str) -> None:
    np.testing.assert_array_equal(decode(**{name: np.array([0, 9, 200], code)}).intensity, [0, 9, 200])


@pytest.mark.parametrize(
    ("name", "code"), [("ring", "u2"), ("channel", "u1"), ("laser_id", "i4"), ("line", "f4"), ("ring", "i1")]
)
def test_ring(name: str, code: str) -> None:
    np.testing.assert_array_equal(decode(**{name: np.array([0, 3, 127], code)}).ring, [0, 3, 127])


@pytest.mark.parametrize(
    ("values", "code", "is_used"),
    [
        ([0, 9, 255], "u2", True),
        ([0, 9, 255], "u1", True),
        ([0, 9, 256], "u2", False),  # firmware before 2.1
        ([0, 0, 0], "u2", False),  # a simulator
        ([0, 9, 255], "f4", False),  # in another scale, perhaps
    ],
)
def test_calibrated_reflectivity_goes_before_intensity(values: list[int], code: str, *, is_used: bool) -> None:
    signal, reflectivity = np.array([40, 500, 6000], np.float32), np.array(values, code)
    both = message(builders.pointcloud2(XYZ, stamp_ns=STAMP_NS, reflectivity=reflectivity, intensity=signal))
    np.testing.assert_array_equal(decode_pointcloud2(both).intensity, reflectivity if is_used else signal)
    np.testing.assert_array_equal(decode_pointcloud2(both, calibrated=False).intensity, signal)


def test_ring_out_of_range_is_clipped() -> None:
    np.testing.assert_array_equal(decode(ring=np.array([-1, 70_000, 5], np.int32)).ring, [0, 65535, 5])
    np.testing.assert_array_equal(decode(ring=np.array([np.nan, 1e30, 5], np.float32)).ring, [0, 65535, 5])


# --- what contradicts itself


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"width": 4}, r"1 x 4 points of 12 bytes in rows of 48 bytes do not fit 36 bytes"),
        ({"width": 4_294_967_295, "height": 4_294_967_295}, r"4294967295 x 4294967295 points"),
        ({"height": 2, "width": 1, "row_step": 30}, r"2 x 1 points of 12 bytes in rows of 30 bytes .* 36 bytes"),
        ({"height": 2, "width": 1, "row_step": 11}, r"2 x 1 points of 12 bytes in rows of 11 bytes"),
        ({"point_step": 11}, r"field z ends at byte 12 of a point of 11 bytes"),
        ({"point_step": 0}, r"ends at byte \d+ of a point of 0 bytes"),
        ({"data": np.zeros(0, np.uint8)}, r"do not fit 0 bytes of data"),
        ({"fields": []}, r"expected the fields x, y and z, found none"),
        ({"fields": [{"name": "x", "datatype": 7}, {"name": "range", "datatype": 7}]}, r"found x, range"),
        ({"fields": [{"name": name, "datatype": 42} for name in "xyz"]}, r"datatype 42, expected 1 to 11"),
        ({"fields": [{"name": x, "datatype": 7, "offset": 2**32 - 1} for x in "xyz"]}, r"ends at byte 4294967299"),
        ({"fields": [{"name": x, "datatype": 7, "count": 2**32 - 1} for x in "xyz"]}, r"of a point of 12 bytes"),
    ],
)
def test_contradictions_are_named(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(MessageError, match=match):
        decode_pointcloud2(changed(**changes))


# --- times of points


SWEEP_NS = np.array([-100_000_000, -50_000_000, 0, 25_000_000, 100_000_000])


def offsets(fields: dict[str, Array], stamp_ns: int = STAMP_NS) -> I32 | None:
    return point_time_offsets(fields, stamp_ns, topic="/points")


@pytest.mark.parametrize(
    ("name", "values", "within_ns"),
    [
        ("time", (SWEEP_NS / 1e9).astype(np.float32), 5),  # velodyne_pointcloud
        ("t", SWEEP_NS.astype(np.int32), 0),
        ("time_stamp", SWEEP_NS.astype(np.int32), 0),
        ("offset_time", SWEEP_NS.astype(np.float64), 0),
        ("timestamp", (STAMP_NS + SWEEP_NS) / 1e9, 240),  # Hesai, RoboSense: float64 of 2023 has steps of 238 ns
        ("time_stamp", (STAMP_NS + SWEEP_NS) / 1e9, 240),  # Nebula, PointXYZIRADT
        ("time", (STAMP_NS + SWEEP_NS) / 1e9, 240),
        ("timestamp", (STAMP_NS + SWEEP_NS).astype(np.float64), 128),  # livox_ros_driver2
        ("timestamp", STAMP_NS + SWEEP_NS, 0),
        ("timestamp", (STAMP_NS + SWEEP_NS).astype(np.uint64), 0),
        ("time", (SWEEP_NS / 1e9).astype(">f4"), 5),
        ("time", (SWEEP_NS / 1e3).astype(np.float32), 5),  # microseconds: data sets of FAST-LIO
        ("time", (SWEEP_NS / 1e6).astype(np.float32), 5),
        ("t", SWEEP_NS.astype(np.float64), 0),
        ("timestamp", (STAMP_NS + SWEEP_NS).astype(">u8"), 0),
    ],
)
def test_spellings_of_drivers(name: str, values: Array, within_ns: int) -> None:
    found = offsets({name: values})
    assert found is not None
    assert found.dtype == np.int32
    assert np.abs(found - SWEEP_NS).max() <= within_ns


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"x": np.ones(3)},
        {"time": np.zeros(3, np.float32)},
        {"time": np.zeros(0, np.float32)},
        {"time": np.array([0, np.nan], np.float32)},
        {"time": np.array([0, 3600.0], np.float32)},  # seconds of the hour
        {"time": np.array([1800.0, 1800.1], np.float32)},
        {"t": np.array([0, 4_000_000_000], np.uint32)},
        {"timestamp": (STAMP_NS + SWEEP_NS) / 1e9 - 3600},  # a clock of its own
        {"timestamp": np.array([-(2**63), 1], np.int64)},  # whose absolute value does not exist
        {"timestamp": np.array([1e300, np.inf])},
    ],
)
def test_no_times(fields: dict[str, Array]) -> None:
    assert offsets(fields) is None


def test_unusable_field_is_logged_once_for_a_topic(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            point_time_offsets({"time": np.array([99.0])}, STAMP_NS, topic="/logged_once")
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["/logged_once"]


@given(
    st.lists(st.integers(-MAX_OFFSET_NS, MAX_OFFSET_NS), min_size=1, max_size=5).filter(any),
    st.integers(10_000_000_000, 4_000_000_000_000_000_000),
)
def test_integers_and_clock_nanoseconds_are_exact(wanted: list[int], stamp_ns: int) -> None:
    np.testing.assert_array_equal(offsets({"t": np.array(wanted, np.int32)}, stamp_ns), wanted)
    np.testing.assert_array_equal(offsets({"timestamp": np.array(wanted, np.int64) + stamp_ns}, stamp_ns), wanted)
