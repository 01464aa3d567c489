"""Memory that is freed is not paid for again."""

import platform
import subprocess
import sys

import pytest

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
