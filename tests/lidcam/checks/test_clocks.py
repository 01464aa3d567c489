"""Clocks that jump, clocks that most others contradict, and messages that come too late."""

from dataclasses import replace
from typing import Literal

import pytest
from frames import RIG

from lidcam.checks.clocks import clock_notes, jump_warnings, late_warnings, slower_warnings, stalled_warnings
from lidcam.pipeline.stages.sync.clocks import Clocks, TimeJump
from lidcam.pipeline.stages.sync.drop_reason import DropReason

S = 10**9


@pytest.mark.parametrize(
    ("kind", "by_s", "topics", "said", "remedy"),
    [
        (
            "stamps",
            12.3,
            "",
            "time: stamps jump back by 12.3 s at 45.2 s: no frame has",
            "--duration 45.2, or --start 45.2",
        ),
        ("stamps", -12.3, "", "time: stamps jump ahead by 12.3 s at 45.2 s: no frame has", "; --start 45.2 leaves out"),
        ("log times", 12.3, "", "time: log times jump back by 12.3 s at 45.2 s: the parts", "two files"),
        ("moved", -3.0, "ab", "left, b: stamps jump ahead by 3.0 s at 45.2 s; they are moved", "NTP"),
        ("set", 3.0, "a", "left: stamps jump back by 3.0 s at 45.2 s and agree with", "--start 45.2"),
    ],
)
def test_a_jump_is_told_with_its_size_and_place(
    kind: Literal["stamps", "log times", "moved", "set"], by_s: float, topics: str, said: str, remedy: str
) -> None:
    jumps = [
        TimeJump(kind, 1_045_200_000_000 + at, round(by_s * S) + at, topic) for at, topic in enumerate(topics or [""])
    ]
    (warning,) = jump_warnings(jumps, {"a": "left"}, start_ns=1000 * S)
    assert str(warning).startswith(said)
    assert remedy in warning.remedy


def test_only_the_first_jumps_are_told_one_by_one() -> None:
    jumps = [TimeJump("stamps", k * 10 * S, 3 * S) for k in range(9)]
    assert str([*jump_warnings(jumps, {}, start_ns=0)][-1]).startswith("time: jumps 4 times more; ")


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


def test_topics_whose_stamps_hardly_advance_are_named() -> None:
    stalled = {"/lidar1": (29, 29), "/left/image": (15, 29), "/odom": (40, 50), "/right/image": (4, 4)}
    assert [warning.subject for warning in stalled_warnings(stalled, RIG)] == ["lidar1", "/odom"]


@pytest.mark.parametrize(
    ("left_out", "apart", "named"), [(0, 0, []), (4, 1, []), (7, 4, ["lidar1"]), (0, 14, ["lidar1"])]
)
def test_lidars_of_which_a_slower_one_costs_sweeps_are_named(left_out: int, apart: int, named: list[str]) -> None:
    topics = [lidar.topic for lidar in RIG.lidars]
    drops = {(topics[0], str(DropReason.LEFT_OUT)): left_out, (topics[0], str(DropReason.TOO_FAR)): apart}
    warnings = [*slower_warnings(drops, dict.fromkeys(topics, 20), RIG)]
    assert [warning.subject for warning in warnings] == named
    assert all(f"sync.required=[{topics[0]}]" in warning.remedy for warning in warnings)
    assert not [*slower_warnings(drops, dict.fromkeys(topics, 20), replace(RIG, lidars=RIG.lidars[:1]))]
