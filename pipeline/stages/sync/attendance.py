"""Counts of frames without a message of a topic, its spans of silence, and which topics share frames."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

from lidcam.pipeline.core.frame import Missing

MAX_SILENCES = 100
"""Maximum number of spans kept per topic; further ones extend the last."""


class Silence(NamedTuple):
    """A span of log time without a message of a topic."""

    start_ns: int | None  # Log time of its last message before; None: there was none
    end_ns: int | None  # Log time of its next message; None: none came
    frames: int = 0  # Number of frames in it

    def covers(self, log_time_ns: int) -> bool:
        """Whether a log time lies in the span."""
        after_start = self.start_ns is None or log_time_ns > self.start_ns
        return after_start and (self.end_ns is None or log_time_ns < self.end_ns)


class Absence(NamedTuple):
    """The frames of a run without a message of one topic."""

    topic: str  # The topic
    frames: int  # Number of frames without a message of it
    silences: tuple[Silence, ...]  # Its spans of silence that have frames, in order; these frames are among `frames`


class Attendance:
    """Keeps the spans of silence, and counts frames without a topic's message, over a whole run."""

    def __init__(self) -> None:
        self._heard_ns: dict[str, int] = {}
        self._silences: dict[str, list[Silence]] = {}
        self._frames: Counter[str] = Counter()
        self._frame_ns = 0
        self.groups: list[set[str]] = []  # Topics that share frames, with one another or by way of others

    def meet(self, topics: Collection[str]) -> None:
        """Record that a frame has messages of these topics."""
        if not any(group.issuperset(topics) for group in self.groups):
            joined = [group for group in self.groups if not group.isdisjoint(topics)]
            others = [group for group in self.groups if group.isdisjoint(topics)]
            self.groups = [*others, set(topics).union(*joined)]

    def hear(self, topic: str, log_time_ns: int | None) -> None:
        """Record a topic's last message in a part of the recording; None: there was none."""
        if log_time_ns is not None:
            self._heard_ns[topic] = log_time_ns

    def come_back(self, topic: str, log_time_ns: int) -> None:
        """End the span of silence that the topic is in, if any."""
        silences = self._silences.get(topic)
        if silences and silences[-1].end_ns is None:
            end_ns = max(log_time_ns, self._frame_ns)  # log times may have jumped back meanwhile
            silences[-1] = silences[-1]._replace(end_ns=end_ns)

    def fall_silent(self, topic: str, heard_ns: int | None) -> None:
        """Open a span of silence, unless one is open.

        Args:
            topic: The topic.
            heard_ns: Log time of its last message; None: there was none in this part of the recording.
        """
        silences = self._silences.setdefault(topic, [])
        if silences and silences[-1].end_ns is None:
            return
        if len(silences) < MAX_SILENCES:
            silences.append(Silence(self._heard_ns.get(topic) if heard_ns is None else heard_ns, None))
        else:
            silences[-1] = silences[-1]._replace(end_ns=None)

    def missing(self, topics: Iterable[str], log_time_ns: int) -> Mapping[str, Missing]:
        """Count a frame recorded at `log_time_ns` without messages of `topics`; why each of them is missing."""
        self._frame_ns = log_time_ns
        found: dict[str, Missing] = {}
        for topic in topics:
            self._frames[topic] += 1
            found[topic] = Missing.NOT_NEAR
            silences = self._silences.get(topic, [])
            for at in range(len(silences))[-2:]:  # frames come out a short time after they were recorded
                if silences[at].covers(log_time_ns):
                    silences[at] = silences[at]._replace(frames=silences[at].frames + 1)
                    found[topic] = Missing.SILENT
        return found

    def absences(self, topics: Iterable[str]) -> tuple[Absence, ...]:
        """Absences so far, in the order of `topics`; topics that were never missing have no entry."""
        return tuple(
            Absence(topic, self._frames[topic], tuple(s for s in self._silences.get(topic, ()) if s.frames))
            for topic in topics
            if self._frames[topic]
        )
