"""Topics that are alive: a message of them was recorded lately.

Judged by log time, not by stamps, so a sensor whose messages all arrive two seconds late is alive. A pause of the whole
recording is no topic's silence: between two messages the clock here advances by half of `silent_after_ns` at most.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from statistics import median

MAX_PERIODS = 2.5
"""Maximum number of periods between messages of a topic before the next is overdue: one lost message makes two."""

FIRST_WAIT = 4
"""Maximum wait for the second message of a topic, whose period is unknown, in units of `silent_after_ns`."""

STEPS = 5
"""Number of steps between stamps whose median is the period of a topic."""


class Liveness:
    """Topics by index; all are alive at first, and so waited for from the start.

    Args:
        topic_count: Number of topics.
        silent_after_ns: A topic is silent after this time without a message, or after 2.5 of its periods if these are
            longer.
    """

    def __init__(self, topic_count: int, *, silent_after_ns: int) -> None:
        self._silent_after_ns = silent_after_ns
        self._clock_ns = 0
        self._log_time_ns: int | None = None
        self._heard_ns = [0] * topic_count  # by this clock
        self._heard_log_ns: list[int | None] = [None] * topic_count
        self._stamps_ns: list[deque[int]] = [deque(maxlen=STEPS + 1) for _ in range(topic_count)]
        self._is_alive = [True] * topic_count
        self._deadline_ns = silent_after_ns

    def advance(self, log_time_ns: int) -> Sequence[int]:
        """Go on to the log time of the next message, and return the topics that have fallen silent by then."""
        if self._log_time_ns is None:
            self._log_time_ns = log_time_ns
        step_ns = log_time_ns - self._log_time_ns
        if step_ns > 0:
            self._log_time_ns = log_time_ns
            self._clock_ns += min(step_ns, self._silent_after_ns // 2)
        if self._clock_ns <= self._deadline_ns:
            return ()
        deadlines_ns = {topic: self._heard_ns[topic] + self._patience_ns(topic) for topic in self._alive()}
        silent = [topic for topic, deadline_ns in deadlines_ns.items() if deadline_ns < self._clock_ns]
        self._silence(silent)
        self._deadline_ns = min((deadlines_ns[topic] for topic in self._alive()), default=self._clock_ns)
        return silent

    def hear(self, topic: int, stamp_ns: int) -> bool:
        """Record the message advanced to, and return whether its topic was silent before it."""
        self._heard_ns[topic] = self._clock_ns
        self._heard_log_ns[topic] = self._log_time_ns
        self._stamps_ns[topic].append(stamp_ns)
        if self._is_alive[topic]:
            return False
        self._is_alive[topic] = True
        self._deadline_ns = min(self._deadline_ns, self._clock_ns + self._silent_after_ns)
        return True

    def end(self) -> Sequence[int]:
        """The topics that are found silent because the recording ends: 2.5 periods after their last message."""
        overdue_ns = {topic: self._clock_ns - self._heard_ns[topic] for topic in self._alive()}
        silent = [topic for topic, ns in overdue_ns.items() if 0 < MAX_PERIODS * self.period_ns(topic) < ns]
        self._silence(silent)
        return silent

    def is_alive(self, topic: int) -> bool:
        """Whether the topic is alive."""
        return self._is_alive[topic]

    def period_ns(self, topic: int) -> int:
        """Time between the topic's last messages, by their stamps; 0 with fewer than two."""
        steps_ns = [step for a, b in pairwise(self._stamps_ns[topic]) if (step := b - a) > 0]
        return round(median(steps_ns)) if steps_ns else 0

    def heard_ns(self, topic: int) -> int | None:
        """Log time by which the topic's last message was recorded; None before the first."""
        return self._heard_log_ns[topic]

    def newest_ns(self, topic: int) -> int | None:
        """Stamp of the topic's last message; None before the first."""
        return self._stamps_ns[topic][-1] if self._stamps_ns[topic] else None

    def _patience_ns(self, topic: int) -> int:
        if len(self._stamps_ns[topic]) == 1:
            return FIRST_WAIT * self._silent_after_ns
        return max(self._silent_after_ns, int(MAX_PERIODS * self.period_ns(topic)))

    def _alive(self) -> list[int]:
        return [topic for topic, is_alive in enumerate(self._is_alive) if is_alive]

    def _silence(self, topics: Sequence[int]) -> None:
        for topic in topics:
            self._is_alive[topic] = False
