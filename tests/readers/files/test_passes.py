"""Log times that jump back within a file: passes are told from disorder, and read one after the other."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import pointcloud2, raw, write_mcap, write_recording
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import IndexType

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.files.passes import MIN_JUMP_NS, pass_starts
from lidcam.readers.open import open_recording

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9
Times = list[tuple[int, int]]  # topic, log time in milliseconds


def starts(recorded: Iterable[tuple[int, int]]) -> list[int]:
    table = np.array([*recorded], np.int64).reshape(-1, 2)
    return [*pass_starts(table[:, 1] * MS, table[:, 0])]


def steady(first_ms: int, last_ms: int, topics: Iterable[int] = (0, 1)) -> Times:
    return [(topic, at_ms + topic) for at_ms in range(first_ms, last_ms, 100) for topic in topics]


@pytest.mark.parametrize(
    ("name", "recorded", "expected"),
    [
        ("nothing", [], []),
        ("one message", [(0, 5)], []),
        ("in order", steady(0, 10_000), []),
        ("one late message", [*steady(0, 5000), (0, 1000), *steady(5000, 9000)], []),
        ("topic by topic", [*steady(0, 9000, (0,)), *steady(0, 9000, (1,))], []),
        ("joined in the wrong order", [*steady(9000, 20_000), *steady(0, 8000)], []),
        ("blocks in the wrong order", [*steady(0, 3000), *steady(6000, 9000), *steady(3000, 6000)], []),
        ("too few to tell", [(0, 0), (0, 5000), *steady(0, 9000)], []),
        ("twice", [*steady(0, 9000), *steady(0, 9000)], [180]),
        ("twice, the second is shorter", [*steady(0, 9000), *steady(0, 2000)], [180]),
        ("back by a part", [*steady(0, 9000), *steady(5000, 12_000)], [180]),
        ("three times", [*steady(0, 4000), *steady(0, 5000), *steady(0, 3000)], [80, 180]),
        ("a topic that is there once", [(9, 0), *steady(0, 4000), *steady(0, 4000), (9, 2)], [81]),
    ],
)
def test_where_passes_begin(name: str, recorded: Times, expected: list[int]) -> None:
    assert starts(recorded) == expected, name


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20_000)), max_size=60), st.integers(0, MIN_JUMP_NS // MS))
def test_small_disorder_is_no_pass(recorded: Times, late_ms: int) -> None:
    order = sorted(recorded, key=lambda one: one[1] + (one[1] * 7919) % (late_ms + 1))  # each late by up to that
    assert starts(order) == []


def messages(encoding: str, *spans_ms: tuple[int, int]) -> list[RawMessage]:
    kind = "ros1" if encoding == "ros1" else "cdr"
    return [
        raw(
            f"/lidar{topic}",
            "sensor_msgs/msg/PointCloud2",
            pointcloud2([[1, 2, 3]], stamp_ns=START_NS + at_ms * MS),
            START_NS + at_ms * MS,
            encoding=kind,  # type: ignore[arg-type]  # one of two words
        )
        for first_ms, last_ms in spans_ms
        for topic, at_ms in steady(first_ms, last_ms)
    ]


@pytest.mark.parametrize("kind", ["bag", "sqlite3", "mcap", "mcap-none", "loose"])
def test_passes_are_read_one_after_the_other(tmp_path: Path, kind: str) -> None:
    recorded = messages("ros1" if kind == "bag" else "cdr", (0, 3000), (1000, 2500))
    path = write_recording(tmp_path / "a", kind, recorded, chunk_bytes=1 << 20 if kind == "mcap-none" else 2000)
    with open_recording([path]) as recording:
        read = [m.log_time_ns for m in recording.messages()]
        some = [m.log_time_ns for m in recording.messages(["/lidar1"], start_ns=START_NS + 2000 * MS)]
        assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS + 2901 * MS)
    assert read == [m.log_time_ns for m in recorded]
    assert some == [START_NS + (at_ms + 1) * MS for at_ms in (*range(2000, 3000, 100), *range(2000, 2500, 100))]


def test_without_indexes_of_messages_an_mcap_is_read_in_the_order_of_time(tmp_path: Path) -> None:
    recorded = messages("cdr", (0, 3000), (1000, 2500))
    kinds: Any = {"index_types": IndexType.ALL & ~IndexType.MESSAGE}
    write_mcap(path := tmp_path / "a.mcap", recorded, chunk_bytes=2000, **kinds)
    with open_recording([path]) as recording:
        assert [m.log_time_ns for m in recording.messages()] == sorted(m.log_time_ns for m in recorded)
