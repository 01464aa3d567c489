"""Files without messages, and warnings of lidars without points."""

from collections import Counter

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.readers.recording import Recording
from lidcam.run.warning import RunWarning


def check_not_empty(recording: Recording) -> None:
    """Check that there is anything to read.

    Raises:
        RecordingError: there is not.
    """
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")


MIN_EMPTY = 3
"""Minimum number of empty messages of a lidar that is named; fewer come from start-up or lost packets."""

MIN_EMPTY_SHARE = 0.1
"""Minimum share of empty messages of a lidar that is named."""


class LidarCheck:
    """Counts each lidar's messages without points over a run."""

    def __init__(self, rig: Rig) -> None:
        self._lidars = {lidar.topic: lidar.name for lidar in rig.lidars}
        self._messages: Counter[str] = Counter()
        self._bad: Counter[str] = Counter()
        # by lidar: number of messages without points, and the first and last frame of them
        self._empty: dict[str, tuple[int, int, int]] = {}

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        bad = {drop.topic for drop in frame.drops if not drop.parts}
        for topic in frame.bundle.messages:
            name = self._lidars.get(topic)
            if name is None:
                continue
            self._messages[name] += 1
            if topic in bad:
                self._bad[name] += 1
            elif not frame.combined.points_by_lidar.get(name, 0):
                index = frame.bundle.index
                count, first, _ = self._empty.get(name, (0, index, index))
                self._empty[name] = (count + 1, first, index)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each lidar whose messages cannot be decoded, or of which many, or all, have no point within range."""
        found = (self._warning(name) for name in self._lidars.values() if self._messages[name])
        return tuple(warning for warning in found if warning is not None)

    def _warning(self, name: str) -> RunWarning | None:
        total, (empty, first, last) = self._messages[name], self._empty.get(name, (0, 0, 0))
        if self._bad[name] == total:
            finding = f"none of its {total} messages can be decoded"
            return RunWarning(name, finding, "-v lists the reasons")
        if empty == total:
            finding = f"{total} messages without a single point in range"
        elif empty >= max(MIN_EMPTY, MIN_EMPTY_SHARE * total):
            finding = f"{empty} of {total} messages without a single point in range, in frames {first} to {last}"
        else:
            return None
        remedy = "the lidar may be covered, or its motor may stand still; else see combine.min_range_m and max_range_m"
        return RunWarning(name, finding, remedy)
