"""Memory that is freed is not paid for again."""

import gc
import platform
import subprocess
import sys
from collections.abc import Iterator

import pytest

from pipeline.core.memory import objects_stay

PROGRAM = """
import resource, sys
import numpy as np
from pipeline.core.memory import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
def frame():
    arrays = [np.ones(1 << 19) for _ in range(5)]
frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
frame()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_pages_of_one_frame_serve_the_next() -> None:
    def pages(how: str) -> int:
        return int(subprocess.run([sys.executable, "-c", PROGRAM, how], check=True, capture_output=True).stdout)

    assert pages("kept") * 20 < pages("plain")


@pytest.fixture
def nothing_frozen() -> Iterator[None]:
    """The tests freeze what they have collected."""
    gc.unfreeze()
    yield
    gc.freeze()


@pytest.mark.usefixtures("nothing_frozen")
def test_what_is_there_is_not_looked_at_until_the_block_ends() -> None:
    with objects_stay():
        assert gc.get_freeze_count() > 1000
        with objects_stay():
            pass
        assert gc.get_freeze_count() > 1000, "of who began"
    assert gc.get_freeze_count() == 0
