"""Clocks that jump, clocks that most others contradict, and messages that come too late."""

import pytest
from frames import RIG

from lidcam.checks.clocks import clock_notes, clocks_off, jump_warnings, late_warnings
from lidcam.pipeline.stages.sync.clocks import Clocks, TimeJump
from lidcam.pipeline.stages.sync.drop_reason import DropReason
from lidcam.run.missing import MissingSensor

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


NEAR = {"/lidar1": S // 10, "/lidar2": S // 10, "/left/image": 0, "/right/image": S // 20}


def absent(*names: str, frames: int = 20, of_frames: int = 20) -> list[MissingSensor]:
    topics = {"lidar1": "/lidar1", "lidar2": "/lidar2", "left": "/left/image", "right": "/right/image"}
    return [MissingSensor(name, topics.get(name, f"/{name}"), frames, of_frames, ()) for name in names]


@pytest.mark.parametrize(
    ("delays_ns", "missing", "sensors"),
    [
        ({}, [], []),
        (NEAR, absent("left"), []),  # near enough: not its clock
        (NEAR | {"/left/image": -3600 * S}, [], []),  # of no consequence
        (NEAR | {"/left/image": -3600 * S}, absent("left"), ["left"]),
        (NEAR | {"/left/image": 5 * S}, absent("left"), []),  # recorded late
        (NEAR | {"/lidar1": -5 * S}, absent("lidar2", "left", "right"), ["lidar1"]),  # the frames are of its time
        ({"/lidar1": 0, "/left/image": -5 * S}, absent("left"), ["left"]),  # of two, the lidar is believed
    ],
)
def test_the_clock_that_most_others_contradict_is_named(
    delays_ns: dict[str, int], missing: list[MissingSensor], sensors: list[str]
) -> None:
    assert [warning.subject for warning in clocks_off(delays_ns, missing, RIG)] == sensors


@pytest.mark.parametrize(("delay_s", "side", "offset_ms"), [(-3599.9, "after", 3600000), (3600.1, "before", -3600000)])
def test_the_offset_is_what_the_rig_file_takes_off(delay_s: float, side: str, offset_ms: int) -> None:
    (warning,) = clocks_off(NEAR | {"/left/image": round(delay_s * S)}, absent("left"), RIG)
    assert str(warning) == (
        f"left: its stamps lie 3600.0 s {side} those of most sensors, so that 1 topic is in no frame; "
        f"set its clock, or give it about time_offset_ms: {offset_ms} in a rig file (--rig)"
    )


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
