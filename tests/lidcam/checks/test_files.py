"""Two recordings given as one are named; the parts of a split recording are not."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from frames import frame

from lidcam.checks.files import FileCheck
from lidcam.pipeline.core.frame import FrameResult

PATHS = tuple(Path(name) for name in ("a.bag", "b.bag", "c.bag", "d.bag"))
TENTH_NS = 100_000_000


def recorded(log_time_ns: int, files: dict[str, int]) -> FrameResult:
    """A frame whose messages lie in the given files."""
    result = frame()
    messages = {
        topic: result.bundle.messages[topic]._replace(order=(file, 0), log_time_ns=log_time_ns)
        for topic, file in files.items()
    }
    return replace(result, bundle=replace(result.bundle, messages=messages))


def named(files: Sequence[dict[str, int]]) -> list[str]:
    check = FileCheck(PATHS)
    for index, by_topic in enumerate(files):
        check.add_frame(recorded(index * TENTH_NS, by_topic))
    return [warning.finding.split(" hold ")[0] for warning in check.warnings]


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ([], []),
        ([{"/lidar1": 0, "/lidar2": 1}] * 30, []),  # one file per sensor
        ([{"/lidar1": 0}] * 20 + [{"/lidar1": 1}] * 20, []),  # parts, one after the other
        ([{"/lidar1": 0}, {"/lidar1": 1}, {"/lidar1": 0}, *[{"/lidar1": 1}] * 20], []),  # parts that overlap a little
        ([{"/lidar1": 0}, {"/lidar1": 1}] * 20, ["a.bag and b.bag"]),
        ([{"/lidar1": 0, "/lidar2": 1}, {"/lidar1": 0, "/lidar2": 2}] * 20, ["b.bag and c.bag"]),
        ([{"/lidar1": 0}] + [{"/lidar1": 1}] * 20 + [{"/lidar1": 0}], ["a.bag and b.bag"]),
    ],
)
def test_files_that_take_turns_are_named(files: list[dict[str, int]], found: list[str]) -> None:
    assert named(files) == found


def test_few_pairs_are_named() -> None:
    assert len(named([{"/lidar1": file} for _ in range(40) for file in range(4)])) == 3
