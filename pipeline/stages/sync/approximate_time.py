"""The adaptive algorithm of message_filters' C++ ApproximateTime policy, for any number of topics.

Source: http://wiki.ros.org/message_filters/ApproximateTime and ros_comm,
message_filters/sync_policies/approximate_time.h. Each message is used at most once and sets never cross. Given the
order within each topic, the sets do not depend on the interleaving of topics unless a queue overflows.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

from lidcam.pipeline.stages.sync.drop_reason import DropReason, OnItemDrop

T = TypeVar("T")

AGE_PENALTY = 0.1
"""Share of its delay by which a later set must be better than the candidate, as in ROS."""


class _Candidate(NamedTuple):
    """The best set found so far; its messages are the first of each queue."""

    start_ns: int  # Smallest stamp of the set
    end_ns: int  # Largest stamp of the set
    pivot: int  # Topic whose first message is in every set of this search; it was the latest when the search began
    pivot_ns: int  # Stamp of that message


class ApproximateTime(Generic[T]):
    """Sets of smallest spread, emitted as soon as no later message can form a better one.

    Queues hold unused messages. During a search, a cursor in each queue separates the messages already compared from
    those ahead; advancing the cursor at the earliest message gives the next set to compare.

    Args:
        topic_count: Number of topics, at least one.
        queue_size: Messages held per topic; if exceeded, the oldest is dropped.
        max_interval_ns: Largest spread of a set, inclusive; None for no bound.
        on_drop: Called for each message that is in no set.
    """

    def __init__(
        self, topic_count: int, *, queue_size: int, max_interval_ns: int | None = None, on_drop: OnItemDrop[T]
    ) -> None:
        self._queues: list[deque[tuple[int, T]]] = [deque() for _ in range(topic_count)]
        self._cursors = [0] * topic_count
        self._overflowed = [False] * topic_count
        self._candidate: _Candidate | None = None
        self._queue_size = queue_size
        self._max_interval_ns = max_interval_ns
        self._on_drop = on_drop

    def add_item(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Add the next message of a topic, and return the sets now certain."""
        queue = self._queues[topic]
        search_waited_for_it = self._cursors[topic] == len(queue)
        queue.append((stamp_ns, item))
        sets = self._search() if search_waited_for_it else []
        if len(queue) > self._queue_size:
            sets += self._make_room(topic)
        return sets

    def flush(self) -> Sequence[tuple[T, ...]]:
        """The sets that become certain because no more messages follow.

        A search pauses when a topic has no message ahead. If none will come, its candidate is the best set. The live
        program in ROS cannot know that and does not emit these sets.
        """
        sets = []
        while self._candidate is not None:
            sets.append(self._take_candidate())
            sets += self._search()
        return sets

    def close(self) -> None:
        """Report all messages still held as dropped."""
        self._candidate = None
        for topic, queue in enumerate(self._queues):
            self._drop_first(topic, len(queue), DropReason.END)

    def _search(self) -> list[tuple[T, ...]]:
        """Compare sets until a topic has no message ahead, and return those found to be best."""
        sets: list[tuple[T, ...]] = []
        while not self._some_topic_has_none_ahead():
            heads_ns = [queue[cursor][0] for queue, cursor in zip(self._queues, self._cursors, strict=True)]
            start_ns, end_ns = min(heads_ns), max(heads_ns)
            first = heads_ns.index(start_ns)
            last = len(heads_ns) - 1 - heads_ns[::-1].index(end_ns)
            # No message lost earlier could be nearer to `last` than the present heads.
            self._overflowed = [lost and topic == last for topic, lost in enumerate(self._overflowed)]

            if self._candidate is None:
                if self._max_interval_ns is not None and end_ns - start_ns > self._max_interval_ns:
                    self._drop_first(first, 1, DropReason.TOO_FAR)
                    continue
                if self._overflowed[last]:
                    self._drop_first(first, 1, DropReason.AFTER_OVERFLOW)
                    continue
                self._candidate = _Candidate(start_ns, end_ns, last, end_ns)
            elif self._weighted_delay_ns(self._candidate, end_ns) < start_ns - self._candidate.start_ns:
                self._forget_passed()
                self._candidate = _Candidate(start_ns, end_ns, self._candidate.pivot, self._candidate.pivot_ns)
            self._cursors[first] += 1

            if first == self._candidate.pivot or self._is_best(self._candidate, end_ns):
                sets.append(self._take_candidate())
        return sets

    def _is_best(self, candidate: _Candidate, end_ns: int) -> bool:
        """Whether no set that contains the pivot and ends at `end_ns` or later can beat the candidate."""
        if self._weighted_delay_ns(candidate, end_ns) >= candidate.pivot_ns - candidate.start_ns:
            return True
        return self._some_topic_has_none_ahead() and self._is_best_whatever_follows(candidate)

    def _is_best_whatever_follows(self, candidate: _Candidate) -> bool:
        """Search on as if each topic with none ahead received the best possible message at once."""
        cursors = list(self._cursors)
        while True:
            heads_ns = [
                queue[cursor][0] if cursor < len(queue) else max(queue[-1][0], candidate.pivot_ns)
                for queue, cursor in zip(self._queues, cursors, strict=True)
            ]
            start_ns = min(heads_ns)
            delay_ns = self._weighted_delay_ns(candidate, max(heads_ns))
            if delay_ns >= candidate.pivot_ns - candidate.start_ns:
                return True
            if delay_ns < start_ns - candidate.start_ns:
                return False
            # Neither holds only while start_ns < pivot_ns, so the earliest head is a real message.
            cursors[heads_ns.index(start_ns)] += 1

    def _weighted_delay_ns(self, candidate: _Candidate, end_ns: int) -> int:
        """How much later than the candidate a set ends, with the age penalty, in whole nanoseconds as in ROS."""
        return math.floor((end_ns - candidate.end_ns) * (1 + AGE_PENALTY) + 0.5)

    def _some_topic_has_none_ahead(self) -> bool:
        return any(len(queue) == cursor for queue, cursor in zip(self._queues, self._cursors, strict=True))

    def _take_candidate(self) -> tuple[T, ...]:
        """Remove the candidate's messages; those compared after them are free for the next search."""
        self._abandon_search()
        return tuple(queue.popleft()[1] for queue in self._queues)

    def _make_room(self, topic: int) -> list[tuple[T, ...]]:
        """Drop the oldest message of a topic, and restart a running search, as it may have been the candidate's."""
        search_was_running = self._candidate is not None
        self._abandon_search()
        self._drop_first(topic, 1, DropReason.QUEUE_FULL)
        self._overflowed[topic] = True
        return self._search() if search_was_running else []

    def _abandon_search(self) -> None:
        self._candidate = None
        self._cursors = [0] * len(self._queues)

    def _forget_passed(self) -> None:
        """Drop the messages before the cursors: the set at the cursors is better than any with them."""
        for topic, cursor in enumerate(self._cursors):
            self._drop_first(topic, cursor, DropReason.LEFT_OUT)
        self._cursors = [0] * len(self._queues)

    def _drop_first(self, topic: int, count: int, reason: DropReason) -> None:
        for _ in range(count):
            self._on_drop(self._queues[topic].popleft()[1], reason)
