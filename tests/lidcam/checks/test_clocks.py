"""Clocks that jump, clocks that most others contradict, and messages that come too late."""

import pytest
from frames import RIG

from lidcam.checks.clocks import clock_notes, jump_warnings, late_warnings
from lidcam.pipeline.stages.sync.clocks import Clocks, TimeJump
from lidcam.pipeline.stages.sync.drop_reason import DropReason

S = 10**9


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("stamps", "time: stamps jump back by 12.3 s at 45.2 s: no frame has messages of both sides; if it was played"),
        ("log times", "time: log times jump back by 12.3 s at 45.2 s: the parts before and after are processed one"),
    ],
)
def test_a_jump_is_told_with_its_size_and_place(kind: str, said: str) -> None:
    jump = TimeJump("stamps" if kind == "stamps" else "log times", 1_045_200_000_000, 12_300_000_000)
    (warning,) = jump_warnings([jump], start_ns=1000 * S)
    assert str(warning).startswith(said)


def test_sensors_without_stamps_are_named() -> None:
    clocks = Clocks({}, on_drop=lambda _drop: None, on_bad=lambda _drop: None)
    assert clock_notes(clocks, {}) == []
    clocks.unstamped |= {"/cam": None, "/odom": None}
    (note,) = clock_notes(clocks, {"/cam": "left"})
    assert note.startswith("left, /odom: all stamps are 0")
    clocks.unstamped |= dict.fromkeys(map(str, range(9)))
    assert " and 1 more: " in clock_notes(clocks, {})[0]


@pytest.mark.parametrize(
    ("drops", "sensors"),
    [
        ({}, []),
        ({("/lidar2", DropReason.TOO_LATE): 10}, ["lidar2"]),
        ({("/lidar2", DropReason.TOO_LATE): 9}, []),
        ({("/left/image", DropReason.TOO_LATE): 90, ("/odom", "cannot be decoded"): 3}, ["left"]),
    ],
)
def test_sensors_that_are_mostly_late_are_named(drops: dict[tuple[str, str], int], sensors: list[str]) -> None:
    warnings = late_warnings(drops, {"/lidar2": 100, "/left/image": 100}, RIG)
    assert [warning.subject for warning in warnings] == sensors
    assert all("sync.queue_size" in warning.remedy for warning in warnings)
