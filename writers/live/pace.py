"""Holds a run back to the pace of its recording, for those who watch."""

import time
from pathlib import Path

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.writers.base import ResultWriter


class Pace(ResultWriter):
    """The first of the writers of a run: it waits until a frame is due, seen from the first one.

    Args:
        times: How many times as fast as it was recorded.
    """

    name = "pace"
    path = Path("--pace")

    def __init__(self, times: float) -> None:
        self._times = times
        self._first: tuple[float, int] | None = None

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Wait for the time of a frame."""
        now_s, stamp_ns = time.monotonic(), result.bundle.stamp_ns
        if self._first is None:
            self._first = now_s, stamp_ns
        started_s, first_ns = self._first
        time.sleep(max(started_s + (stamp_ns - first_ns) / 1e9 / self._times - now_s, 0.0))
        return ()
