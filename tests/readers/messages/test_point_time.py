import logging

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import I32, Array
from lidcam.readers.messages.pointcloud2 import MAX_OFFSET_NS, point_time_offsets

STAMP_NS = 1_700_000_000_123_456_789
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
