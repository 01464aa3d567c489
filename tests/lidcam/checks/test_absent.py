"""A recorded sensor that no frame has is named, and the clock that is to blame, if one is."""

import pytest
from frames import RIG

from lidcam.checks.absent import absence_warnings, clocks_off
from lidcam.checks.missing import MissingSensor, SilentSpan

S = 10**9
NEAR = {"/lidar1": S // 10, "/lidar2": S // 10, "/left/image": 0, "/right/image": S // 20}


def absent(*names: str, frames: int = 20, of_frames: int = 20) -> list[MissingSensor]:
    topics = {"lidar1": "/lidar1", "lidar2": "/lidar2", "left": "/left/image", "right": "/right/image"}
    return [MissingSensor(name, topics.get(name, f"/{name}"), frames, of_frames, ()) for name in names]


@pytest.mark.parametrize(
    ("delays_ns", "missing", "sensors"),
    [
        ({}, [], []),
        ({}, absent("left"), []),
        (NEAR, absent("left"), []),  # near enough: not its clock
        (NEAR | {"/left/image": -3600 * S}, [], []),  # of no consequence
        (NEAR | {"/left/image": -3600 * S}, absent("right", frames=10), []),
        (NEAR | {"/left/image": -3600 * S}, absent("left"), ["left"]),
        (NEAR | {"/left/image": 3600 * S}, absent("left"), ["left"]),
        (NEAR | {"/left/image": 5 * S}, absent("left"), []),  # recorded late
        (NEAR | {"/lidar1": -5 * S}, absent("lidar2", "left", "right"), ["lidar1"]),  # the frames are of its time
        ({"/lidar1": 0, "/left/image": -5 * S}, absent("left"), ["left"]),  # of two, the lidar is believed
    ],
)
def test_the_clock_that_most_others_contradict_is_named(
    delays_ns: dict[str, int], missing: list[MissingSensor], sensors: list[str]
) -> None:
    assert [warning.subject for warning in clocks_off(delays_ns, missing, RIG)] == sensors


@pytest.mark.parametrize(
    ("delay_s", "text"),
    [
        (-3599.9, "after those of most sensors, so that 1 topic is in no frame; set its clock, or give it about "),
        (3600.1, "before those of most sensors, so that 1 topic is in no frame; set its clock, or give it about "),
    ],
)
def test_the_offset_is_what_the_rig_file_takes_off(delay_s: float, text: str) -> None:
    (warning,) = clocks_off(NEAR | {"/left/image": round(delay_s * S)}, absent("left"), RIG)
    sign = "" if delay_s < 0 else "-"
    assert str(warning) == (f"left: its stamps lie 3600.0 s {text}time_offset_ms: {sign}3600000 in a rig file (--rig)")


@pytest.mark.parametrize(
    ("missing", "sensors"),
    [
        ([], []),
        (absent("left", frames=19), []),
        (absent("left", frames=9, of_frames=9), []),  # by chance, of a sensor at a low rate
        (absent("left", "left (boxes)", "other (boxes)"), ["left", "other (boxes)"]),
        ([MissingSensor("left", "/left/image", 20, 20, (SilentSpan(None, None, 20),))], []),  # said as silence
        ([MissingSensor("left", "/left/image", 20, 20, (SilentSpan(1.0, None, 12),))], ["left"]),
    ],
)
def test_sensors_that_no_frame_has_are_named(missing: list[MissingSensor], sensors: list[str]) -> None:
    assert [warning.subject for warning in absence_warnings(missing)] == sensors
