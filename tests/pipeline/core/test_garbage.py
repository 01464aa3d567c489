"""What the garbage collector looks at."""

import gc
import subprocess
import sys
from collections.abc import Iterator

import pytest

from pipeline.core.garbage import collect_late, keep_objects, objects_stay

PROGRAM = """
import atexit, gc
atexit.register(lambda: print(gc.get_freeze_count() > 1000))  # called behind those that are registered later
from pipeline.core.garbage import LATE_OBJECTS, collect_late
collect_late()
print(gc.get_threshold()[0] == LATE_OBJECTS)
"""


@pytest.fixture
def nothing_frozen() -> Iterator[None]:
    """The tests freeze what they have collected."""
    gc.unfreeze()
    yield
    gc.unfreeze()
    gc.freeze()


@pytest.mark.usefixtures("nothing_frozen")
def test_what_is_there_is_not_looked_at_until_the_block_ends() -> None:
    with objects_stay():
        assert gc.get_freeze_count() > 1000
        with objects_stay():
            pass
        assert gc.get_freeze_count() > 1000, "of who began"
    assert gc.get_freeze_count() == 0


def test_a_program_looks_for_garbage_late_and_not_when_it_ends() -> None:
    assert subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True).stdout == (
        "True\nTrue\n"
    )


@pytest.mark.usefixtures("nothing_frozen")
def test_work_is_collected_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = gc.get_threshold()
    monkeypatch.setattr("atexit.register", lambda _: None)
    collect_late()
    assert gc.get_threshold() != usual
    with objects_stay():
        assert gc.get_threshold() == usual
    collect_late()
    keep_objects()
    assert gc.get_threshold() == usual
    assert gc.get_freeze_count() > 1000
