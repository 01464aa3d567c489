import threading
from typing import Any

import pytest

from lidcam.pipeline.parallel.background import Background


def failing() -> None:
    raise OSError(28, "No space left on device")


def open_when_called(gate: threading.Event, owner: Any, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a gate open as soon as somebody calls a method, and not before."""
    called = getattr(owner, method)

    def opening(*args: object) -> object:
        gate.set()
        return called(*args)

    monkeypatch.setattr(owner, method, opening)


@pytest.mark.parametrize("count", [0, 1, 50])
def test_jobs_are_done_in_order_on_another_thread(count: int) -> None:
    done: list[tuple[int, bool]] = []
    background = Background(weight=3, name="test")

    def job(number: int) -> None:
        done.append((number, threading.current_thread() is threading.main_thread()))

    for number in range(count):
        background.add_job(lambda number=number: job(number), weight=number % 5)  # type: ignore[misc]  # bound at once
    background.finish()
    background.close()
    assert done == [(number, False) for number in range(count)]


def test_no_more_waits_than_the_limit_but_for_one_heavy_job(monkeypatch: pytest.MonkeyPatch) -> None:
    background, gate = Background(weight=10, name="test"), threading.Event()
    background.add_job(gate.wait, weight=100)  # heavier than the limit, and taken
    open_when_called(gate, background._changed, "wait", monkeypatch)
    background.add_job(lambda: None, weight=1)
    assert gate.is_set(), "it has waited"
    background.finish()
    background.close()


def test_an_error_ends_the_work_and_is_raised_by_what_comes_next() -> None:
    background, done = Background(weight=10, name="test"), []
    background.add_job(failing, weight=1)
    with pytest.raises(OSError, match="No space left"):
        background.finish()
    with pytest.raises(OSError, match="No space left"):
        background.add_job(lambda: done.append(1), weight=1)
    with pytest.raises(OSError, match="No space left"):
        background.finish()
    background.close()
    assert done == []


def test_an_error_wakes_who_waits_for_room(monkeypatch: pytest.MonkeyPatch) -> None:
    background, gate = Background(weight=1, name="test"), threading.Event()

    def fail_later() -> None:
        gate.wait()
        failing()

    background.add_job(fail_later, weight=1)
    open_when_called(gate, background._changed, "wait", monkeypatch)
    with pytest.raises(OSError, match="No space left"):
        background.add_job(lambda: None, weight=1)
    background.close()


def test_closing_waits_for_the_job_in_work_and_drops_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    background, gate, done = Background(weight=10, name="test"), threading.Event(), []
    begun = threading.Event()

    def first() -> None:
        begun.set()
        gate.wait()
        done.append(1)

    background.add_job(first, weight=1)
    background.add_job(lambda: done.append(2), weight=1)
    begun.wait()
    open_when_called(gate, background._thread, "join", monkeypatch)
    background.close()
    assert done == [1]
    background.close()  # does nothing more
