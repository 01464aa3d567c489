"""The end of a command: its exit code and line, and what `--strict` lets pass."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from summaries import changed, sound_summary

from lidcam.cli.verdict import Verdict, first_of, strict_failure
from lidcam.pipeline.core.errors import CheckError, IncompleteError
from lidcam.readers.recording import Loss
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.missing import MissingSensor, SilentSpan
from lidcam.run.summary import DropCount, RunSummary


def with_drops(used: int, *drops: DropCount) -> RunSummary:
    return changed(sound_summary(), inputs={"messages_used": {"/a": used}}, drops={"messages": drops})


def test_a_run_that_used_everything() -> None:
    assert not strict_failure(sound_summary())
    assert not strict_failure(with_drops(1, DropCount("/a", "packets", 900, "", "parts")))


@pytest.mark.parametrize(
    ("used", "dropped", "passes"),
    [
        (95, 5, True),
        (3, 2, True),  # one at either end
        (0, 1, False),
    ],
)
def test_the_share_of_a_topic(used: int, dropped: int, passes: bool) -> None:
    failure = strict_failure(with_drops(used, DropCount("/a", "x", dropped - 1, ""), DropCount("/a", "y", 1, "")))
    share = f"/a: expected at most 5 % of the messages dropped, found {dropped} of {used + dropped}"
    assert failure == "" if passes else failure.startswith(f"--strict: {share}")


@pytest.mark.parametrize(("frames", "passes"), [(2, True), (5, True), (6, False), (100, False)])
def test_a_sensor_that_falls_silent(frames: int, passes: bool) -> None:
    slow = MissingSensor("cam2", "/cam2", 50, 100, ())
    silent = MissingSensor("cam1", "/cam1", frames, 100, (SilentSpan(1.0, None, frames),))
    found = changed(sound_summary(), sensors={"missing": (slow, silent)})
    line = f"--strict: cam1: silent from 1.0 s to the end, {frames} of 100 frames lack it; the outputs are complete"
    assert strict_failure(found) == ("" if passes else line)


def test_what_is_left_out_and_damaged() -> None:
    summary, bag = sound_summary(), Path("drive.bag")
    fault = SensorFault("cam1", "/cam1/image", "no intrinsics")
    left_out = "--strict: cam1 (/cam1/image) is left out: no intrinsics; the outputs are complete"
    assert strict_failure(changed(summary, sensors={"faults": (fault,)})) == left_out
    damaged = changed(summary, inputs={"losses": (Loss(bag, 0, "x"), Loss(bag, 9, "x"))})
    assert strict_failure(damaged) == "--strict: drive.bag: 2 damaged parts; the outputs are complete"
    assert strict_failure(changed(summary, sensors={"faults": (fault,) * 7})).endswith(
        "; and 3 more; the outputs are complete"
    )


@pytest.mark.parametrize(
    ("verdict", "failure", "code", "error", "line"),
    [
        (Verdict(), "", 0, None, ""),
        (Verdict((), ["a"]), "", 3, IncompleteError, "a"),
        (Verdict((), [*"abcdef"]), "", 3, IncompleteError, "a; b; c; d; and 2 more"),
        (Verdict(("it failed", "twice"), ["a"]), "it failed; twice", 1, CheckError, "it failed; twice"),
    ],
)
def test_the_exit_code_and_the_line(
    verdict: Verdict, failure: str, code: int, error: type[Exception] | None, line: str
) -> None:
    assert verdict.tree() == {"failure": failure, "incomplete": [*verdict.incomplete], "exit_code": code}
    assert failure or first_of(verdict.incomplete) == line
    with pytest.raises(error, match=f"^{line}$") if error else nullcontext():
        verdict.end()
