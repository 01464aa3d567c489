"""Lidars whose messages have no points, or cannot be decoded."""

from collections import Counter

from lidcam.checks.warning import RunWarning
from pipeline.core.frame import FrameResult
from pipeline.core.rig import Rig

__all__ = ["LidarCheck"]


class LidarCheck:
    """Counts the points of each lidar over a run."""

    def __init__(self, rig: Rig) -> None:
        self._lidars = {lidar.topic: lidar.name for lidar in rig.lidars}
        self._messages: Counter[str] = Counter()
        self._bad: Counter[str] = Counter()
        self._points: Counter[str] = Counter()

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        self._messages.update(self._lidars[topic] for topic in frame.bundle.messages if topic in self._lidars)
        self._bad.update(
            self._lidars[drop.topic] for drop in frame.drops if drop.topic in self._lidars and not drop.parts
        )
        self._points.update(frame.combined.points_by_lidar)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each lidar that sent messages, none of them with a point within range."""
        return tuple(
            self._warning(name) for name in self._lidars.values() if self._messages[name] and not self._points[name]
        )

    def _warning(self, name: str) -> RunWarning:
        count = self._messages[name]
        if self._bad[name] == count:
            return RunWarning(
                name, f"none of its {count} messages can be decoded", "see the reason in the table of messages"
            )
        return RunWarning(
            name,
            f"{count} messages without a single point in range",
            "the lidar may be covered, or its motor may stand still; else see combine.min_range_m and max_range_m",
        )
