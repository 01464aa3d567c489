"""The frames with which recorded truth is drawn.

Truth is often recorded later than what it describes, and later than the result of that moment is complete. Drawn when
it was recorded, it would trail the objects: at 10 m/s and 0.1 s, by a metre. So it is drawn with the frame whose stamp
is nearest to its own.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.true_boxes import TrueBoxes

SAME_CLOCK_NS = 2_000_000_000
"""Truth whose stamp is farther from every frame has another clock: then it goes by the times of recording."""

LASTS_NS = 1_500_000_000
"""Where no newer truth is recorded for this time, it is drawn no more: it would ride along with a vehicle."""

MAX_FRAMES, MAX_WAITING = 256, 256
"""Frames that truth may belong to, and messages of it that may wait for the next frame."""


@dataclass(frozen=True, slots=True)
class FrameTime:
    """A frame."""

    index: int  # Its number
    stamp_ns: int  # When it was measured
    log_time_ns: int  # When its reference message was recorded


class TruthTimes:
    """Finds the frames of the truth of a run. What belongs to the frame still to come waits for it."""

    def __init__(self) -> None:
        self._frames: deque[FrameTime] = deque(maxlen=MAX_FRAMES)
        self._waiting: list[TrueBoxes] = []
        self._drawn: dict[str, TrueBoxes] = {}  # by topic, the last one

    def add_frame(self, bundle: SensorBundle) -> list[tuple[FrameTime, TrueBoxes]]:
        """The truth whose frame is known now, in the order in which it was recorded, with that frame.

        Where the truth of a topic has ended, this frame has one without objects.
        """
        here = FrameTime(bundle.index, bundle.stamp_ns, bundle.log_time_ns)
        self._frames.append(here)
        self._waiting += bundle.truth
        known = [truth for truth in self._waiting if truth.stamp_ns <= bundle.stamp_ns or self._has_other_clock(truth)]
        late = [truth for truth in self._waiting if truth not in known]
        known, self._waiting = [*known, *late[:-MAX_WAITING]], late[-MAX_WAITING:]
        self._drawn |= {truth.topic: truth for truth in known}
        ended = [one for one in self._drawn.values() if here.log_time_ns - one.log_time_ns > LASTS_NS]
        return self._with_frames(known) + [(here, self._drawn.pop(one.topic).none_at(here.stamp_ns)) for one in ended]

    def rest(self) -> list[tuple[FrameTime, TrueBoxes]]:
        """The truth that waits for a frame after the last one."""
        waiting, self._waiting = self._waiting, []
        return self._with_frames(waiting)

    def _has_other_clock(self, truth: TrueBoxes) -> bool:
        return all(abs(frame.stamp_ns - truth.stamp_ns) > SAME_CLOCK_NS for frame in self._frames)

    def _with_frames(self, truth: Iterable[TrueBoxes]) -> list[tuple[FrameTime, TrueBoxes]]:
        return [(self._nearest(boxes), boxes) for boxes in truth]

    def _nearest(self, truth: TrueBoxes) -> FrameTime:
        if self._has_other_clock(truth):
            return min(self._frames, key=lambda frame: (abs(frame.log_time_ns - truth.log_time_ns), frame.index))
        return min(self._frames, key=lambda frame: (abs(frame.stamp_ns - truth.stamp_ns), frame.index))
