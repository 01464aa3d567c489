"""The ways of all tracks, seen from above, simplified so that a page can hold them."""

from collections.abc import Iterable

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64

MAX_POINTS = 60_000
"""Corners of all polylines together; of more, each is drawn with fewer."""

FIRST_TOLERANCE_M = 0.01


class Courses:
    """Gathers polylines by track: a corner where the track has gone on by more than a tolerance, which grows.

    Attributes:
        tolerance_m: How far apart corners are.
        left_out: Tracks that are not drawn, the shortest, because there are too many.
    """

    def __init__(self) -> None:
        self.tolerance_m, self.left_out = FIRST_TOLERANCE_M, 0
        self._lines: dict[int, list[tuple[float, float, float, float]]] = {}  # x, y, speed, seconds
        self._ends: dict[int, tuple[float, float, float, float]] = {}  # the last place, a corner or not
        self._points = 0
        self._dropped: set[int] = set()

    def add_frame(self, time_s: float, numbers: I64, xy: F64, speeds: F64) -> None:
        """Take in the tracks of one frame: their numbers (N,), places (N, 2) in a fixed frame, and speeds (N,)."""
        rows = zip(numbers.tolist(), xy.tolist(), speeds.tolist(), strict=True)
        for number, (x, y), speed in rows:
            if number in self._dropped:
                continue
            here = (x, y, speed, time_s)
            self._ends[number] = here
            line = self._lines.get(number)
            if line is None:
                self._lines[number] = [here]
                self._points += 1
            elif (x - line[-1][0]) ** 2 + (y - line[-1][1]) ** 2 > self.tolerance_m**2:
                line.append(here)
                self._points += 1
        while self._points + len(self._lines) > MAX_POINTS:
            self._simplify()

    def lines(self) -> Iterable[tuple[int, F64]]:
        """Number and (K, 4) corners of each track: x, y in metres, speed in m/s, seconds since the first frame."""
        for number, line in self._lines.items():
            end = self._ends[number]
            yield number, np.array(line if line[-1] == end else [*line, end])

    def _simplify(self) -> None:
        """Draw lines with half the corners; where they have but two each, leave out the shorter half of them."""
        if self._points <= 2 * len(self._lines):
            lengths = {
                n: np.hypot(end[0] - self._lines[n][0][0], end[1] - self._lines[n][0][1])
                for n, end in self._ends.items()
            }
            shortest = sorted(lengths, key=lambda number: (lengths[number], number))[: len(lengths) // 2]
            for number in shortest:
                del self._lines[number], self._ends[number]
            self._dropped.update(shortest)
            self.left_out += len(shortest)
        else:
            self.tolerance_m *= 2
            self._lines = {number: _thinned(line, self.tolerance_m) for number, line in self._lines.items()}
        self._points = sum(map(len, self._lines.values()))


def _thinned(
    line: list[tuple[float, float, float, float]], tolerance_m: float
) -> list[tuple[float, float, float, float]]:
    kept = line[:1]
    for point in line[1:]:
        if (point[0] - kept[-1][0]) ** 2 + (point[1] - kept[-1][1]) ** 2 > tolerance_m**2:
            kept.append(point)
    return kept
