"""Progress on terminals and elsewhere."""

import io
import logging
import re
from contextlib import ExitStack, nullcontext
from types import SimpleNamespace
from typing import cast

import pytest
from rich.console import Console

from lidcam.cli.printing.log import progress_log
from lidcam.cli.printing.progress import show_progress, show_training
from lidcam.cli.printing.running import ShownProgress
from lidcam.run.frames import RunInput
from lidcam.run.tally import RunProgress

FACTS = "12 frames, 3.0 a second"


class Clock:
    """Wall time that stands still unless it is moved."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(autouse=True)
def log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, progress_log.name)


def test_there_is_none_where_the_user_wants_quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, progress_log.name)
    text, clock = io.StringIO(), Clock()
    with show_progress(4.0, err=Console(file=text, force_terminal=True, width=80), clock=clock) as advance:
        clock.now_s += 60
        advance(2.5, FACTS)
    assert text.getvalue() == ""
    assert caplog.messages == []


def test_facts_of_a_long_recording_leave_room_for_the_time_left(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, progress_log.name)
    text = io.StringIO()
    with show_progress(3600, err=Console(file=text, force_terminal=True, width=80), whatever_is_logged=True) as advance:
        advance(1234.5, "12345 frames, 12.1/s, 123456 detections, 12000 written, 1234 dropped")
    assert re.search("1234.5 of 3600.0 s.*12345 frames.*-:--:--.*1234 dropped", text.getvalue(), re.DOTALL)


def test_a_line_every_ten_seconds(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    with show_progress(30.0, err=Console(file=io.StringIO()), clock=clock) as advance:
        for second in range(26):
            clock.now_s = 100.0 + second
            advance(float(second), FACTS if second < 15 else "")
    assert caplog.messages == [f"10.0 of 30.0 s, {FACTS}", "20.0 of 30.0 s"]


def test_the_time_left_of_a_training_that_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    with show_training(err=Console(file=io.StringIO()), clock=clock) as told:
        for share in (0.5, 0.51, 0.6):
            clock.now_s += 60
            told(share, "step 1")
    assert caplog.messages == [
        "training: 50%, step 1",
        "training: 51%, about 49 min left, step 1",
        "training: 60%, about 8 min left, step 1",
    ]


def test_a_run_tells_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[float, str]] = []
    bar = nullcontext(lambda done_s, facts: told.append((done_s, facts)))
    monkeypatch.setattr("lidcam.cli.printing.running.show_progress", lambda *_, **__: bar)
    window, recording = SimpleNamespace(start_ns=None, stop_ns=None), SimpleNamespace(start_ns=0, end_ns=4 * 10**9)
    with ExitStack() as stack:
        shown = ShownProgress(stack)
        shown.opened(cast(RunInput, SimpleNamespace(window=window, recording=recording)))
        for written in (0, 3):
            shown.advanced(RunProgress(frames=3, written=written, detections=7, drops=0, log_time_ns=10**9))
        shown.finishing()
    assert [done_s for done_s, _ in told] == [1.0, 1.0, 4.0]
    ends = "7 detections, tracks follow", "7 detections, 3 written", "finishing the outputs"
    assert all(facts.endswith(end) for (_, facts), end in zip(told, ends, strict=True))
