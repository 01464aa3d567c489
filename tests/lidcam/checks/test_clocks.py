import pytest

from lidcam.checks.clocks import MAX_JUMPS_NAMED, clock_notes, jump_warnings
from pipeline.stages.sync.clocks import Clocks, TimeJump

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


@pytest.mark.parametrize("count", [0, 1, MAX_JUMPS_NAMED, MAX_JUMPS_NAMED + 3])
def test_many_jumps_are_summed_up(count: int) -> None:
    warnings = jump_warnings([TimeJump("stamps", k * S, S) for k in range(count)], start_ns=0)
    assert len(warnings) == min(count, MAX_JUMPS_NAMED + 1)
    assert ("3 times more" in str(warnings[-1:])) == (count > MAX_JUMPS_NAMED)


def test_sensors_without_stamps_are_named() -> None:
    clocks = Clocks({}, on_drop=lambda _drop: None, on_bad=lambda _drop: None)
    assert clock_notes(clocks, {}) == []
    clocks.unstamped |= {"/cam": None, "/odom": None}
    (note,) = clock_notes(clocks, {"/cam": "left"})
    assert note.startswith("left, /odom: all stamps are 0")
    clocks.unstamped |= dict.fromkeys(map(str, range(9)))
    assert " and 1 more: " in clock_notes(clocks, {})[0]
