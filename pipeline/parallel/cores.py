"""How many cores this process may use."""

import math
import os
from pathlib import Path

THREADS_OF_LIBRARIES = "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"
"""Environment variables for the number of threads of OpenMP and OpenBLAS, and of OpenCV, whose idle threads spin. The
libraries read them once, when they are loaded."""

CGROUP_LIMIT = Path("/sys/fs/cgroup/cpu.max")
"""Processor time of a container: microseconds, or `max`, per period in microseconds."""


def usable_cores() -> int:
    """The cores that this process may run on, and no more than the share of its container is worth."""
    if not hasattr(os, "fork"):  # Windows: processes cannot share the work there
        return 1
    # macOS does not tell where a process may run.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        share, period = CGROUP_LIMIT.read_text(encoding="ascii").split()
        return min(cores, max(math.ceil(int(share) / int(period)), 1))
    except (OSError, ValueError):
        return cores  # no container, or one without a limit
