"""When another process is worth its start."""

import math

__all__ = ["Sharing"]

START_S = 1.0
"""Seconds of processor time until a process works on its first frame: it imports libraries. 0 awaits all of them."""

TRIED = 2
"""Frames that tell how long a frame takes; the first also loads and compiles what the others use."""


class Sharing:
    """Decides how many processes a run has, from the frames that are left and the time that they take.

    The process that reads works on frames itself from the first one on, so nobody waits for others to start. It asks
    for more only when it has time for a frame: where reading and writing fill it, more processes do not help.
    """

    def __init__(self, workers: int, expected: int) -> None:
        """Plan a run.

        Args:
            workers: Number of processes at most, with the one that reads.
            expected: About how many frames there will be.
        """
        self._workers, self._expected = workers, expected
        self._tried, self._frame_s = 0, math.inf

    def took(self, seconds: float) -> None:
        """Learn what a frame took."""
        self._tried, self._frame_s = self._tried + 1, min(self._frame_s, seconds)

    @property
    def at_once(self) -> int:
        """How many processes to start, and to wait for, before the first frame."""
        return self._workers - 1 if START_S == 0 else 0

    def more(self, others: int, done: int) -> int:
        """How many processes to start now: at most as many as there are.

        Args:
            others: How many there are beside the one that reads.
            done: Number of frames that are done.
        """
        if self._tried < TRIED or START_S == 0:
            return 0
        left_s = max(self._expected - done, 0) * self._frame_s
        worth = int(left_s / START_S)  # as much work for each as its start costs
        return max(min(self._workers, 2 * (1 + others), worth) - (1 + others), 0)
