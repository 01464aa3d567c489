"""What happened when: sums over steps of time that grow with the recording."""

from collections.abc import Mapping

import numpy as np

from lidcam.pipeline.core.arrays import F64

MAX_STEPS = 480
"""Steps of time on a page; a phone has fewer columns of pixels, a desk has not many more."""

FIRST_STEP_S = 0.1


class Timeline:
    """Sums by name and step of time; where there are too many steps, two become one.

    Attributes:
        step_s: Length of a step.
    """

    def __init__(self) -> None:
        self.step_s = FIRST_STEP_S
        self.frames = np.zeros(MAX_STEPS)
        self._sums: dict[str, F64] = {}
        self._maxima: dict[str, F64] = {}
        self._last = 0

    def add_frame(self, time_s: float, sums: Mapping[str, float], maxima: Mapping[str, float]) -> None:
        """Take in a frame at a time since the first; one from before it counts as of the first step."""
        while (step := max(int(time_s / self.step_s), 0)) >= MAX_STEPS:
            self._double()
        self._last = max(self._last, step)
        self.frames[step] += 1
        for name, value in sums.items():
            if name not in self._sums:
                self._sums[name] = np.zeros(MAX_STEPS)
            self._sums[name][step] += value
        for name, value in maxima.items():
            if name not in self._maxima:
                self._maxima[name] = np.zeros(MAX_STEPS)
            self._maxima[name][step] = max(self._maxima[name][step], value)

    @property
    def times_s(self) -> F64:
        """(S,) beginning of each step up to the last with a frame, seconds since the first frame."""
        return np.arange(self._last + 1, dtype=np.float64) * self.step_s

    def counts(self) -> F64:
        """(S,) frames in each step."""
        return self.frames[: self._last + 1]

    def sums(self, name: str) -> F64:
        """(S,) sum in each step."""
        return self._sums.get(name, np.zeros(MAX_STEPS))[: self._last + 1]

    def maxima(self, name: str) -> F64:
        """(S,) largest value in each step; 0 without any."""
        return self._maxima.get(name, np.zeros(MAX_STEPS))[: self._last + 1]

    def at_least(self, step_s: float) -> None:
        """Make steps long enough, for instance so that every one has a frame."""
        while self.step_s < step_s:
            self._double()

    def _double(self) -> None:
        self.step_s *= 2
        self._last //= 2
        half = np.zeros(MAX_STEPS // 2)
        self.frames = np.concatenate([self.frames.reshape(-1, 2).sum(1), half])
        self._sums = {name: np.concatenate([one.reshape(-1, 2).sum(1), half]) for name, one in self._sums.items()}
        self._maxima = {name: np.concatenate([one.reshape(-1, 2).max(1), half]) for name, one in self._maxima.items()}
