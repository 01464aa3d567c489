"""The rules of message_filters' Python ApproximateTimeSynchronizer, with a search in polynomial time.

Source: ros_comm, message_filters/__init__.py. Greedy and dependent on the order of arrival: the first set that fits the
newest message is emitted at once, so sets may come out of time order. ROS tries combinations one by one, exponentially
many in the number of topics; here the same combination is found without trying those that cannot fit.
"""

from collections.abc import Sequence
from typing import Generic, TypeVar

from pipeline.stages.sync.policy import DropReason, OnItemDrop

__all__ = ["ApproximateTimePython", "first_combination"]

T = TypeVar("T")


class ApproximateTimePython(Generic[T]):
    """At most one set per message: the first in product order, nearest messages first, with a spread below slop.

    Args:
        topic_count: Number of topics, at least one.
        queue_size: Messages held per topic; if exceeded, the one with the smallest stamp is dropped, even the newest.
        slop_ns: Exclusive limit of the spread of a set; with 0 there are no sets.
        on_drop: Called for each message that is in no set.
    """

    def __init__(self, topic_count: int, *, queue_size: int, slop_ns: int, on_drop: OnItemDrop[T]) -> None:
        self._queues: list[dict[int, T]] = [{} for _ in range(topic_count)]
        self._queue_size = queue_size
        self._slop_ns = slop_ns
        self._on_drop = on_drop

    def add(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Add a message, and return the set that it completes, if any.

        An equal stamp replaces the queued message and keeps its place among ties.
        """
        queue = self._queues[topic]
        if stamp_ns in queue:
            self._on_drop(queue[stamp_ns], DropReason.REPLACED)
        queue[stamp_ns] = item
        if len(queue) > self._queue_size:
            oldest_ns = min(queue)
            reason = DropReason.TOO_LATE if oldest_ns == stamp_ns else DropReason.QUEUE_FULL
            self._on_drop(queue.pop(oldest_ns), reason)
            if oldest_ns == stamp_ns:
                return []
        candidates = self._candidates(topic, stamp_ns)
        stamps_ns = first_combination(stamp_ns, candidates, self._slop_ns)
        if stamps_ns is None:
            return []
        stamps_ns.insert(topic, stamp_ns)
        return [tuple(queue.pop(chosen) for queue, chosen in zip(self._queues, stamps_ns, strict=True))]

    def flush(self) -> Sequence[tuple[T, ...]]:
        """Nothing: a set never waits for later messages."""
        return []

    def close(self) -> None:
        """Report all messages still held as dropped."""
        for queue in self._queues:
            for item in queue.values():
                self._on_drop(item, DropReason.END)
            queue.clear()

    def _candidates(self, topic: int, stamp_ns: int) -> list[list[int]]:
        """Stamps of each other topic within slop of the newest message, nearest first, ties in order of insertion.

        Stops at the first topic that has none; its empty list is then the last.
        """
        candidates = []
        for other, queue in enumerate(self._queues):
            if other == topic:
                continue
            near = [queued_ns for queued_ns in queue if abs(queued_ns - stamp_ns) <= self._slop_ns]
            near.sort(key=lambda queued_ns: abs(queued_ns - stamp_ns))
            candidates.append(near)
            if not near:
                break
        return candidates


def first_combination(newcomer_ns: int, candidates: Sequence[Sequence[int]], slop_ns: int) -> list[int] | None:
    """The first of `itertools.product(*candidates)` that spreads less than slop together with the newcomer.

    A combination fits if a window [start, start + slop) contains all its stamps, so a stamp s allows the starts in
    (s - slop, s]. First, the starts that leave at least one stamp to each of the topics from here on are computed, for
    each topic. Then the first stamp whose starts overlap those of the later topics is the right one, and no choice is
    ever revised: O(topics x (topics + queue size)) steps.

    Args:
        newcomer_ns: Stamp of the newest message, part of every combination.
        candidates: Stamps of each other topic, all within slop of the newcomer, in order of preference.
        slop_ns: Exclusive limit of the spread.
    """
    if not all(candidates):
        return None
    nearest_ns = [stamps_ns[0] for stamps_ns in candidates]
    if max([newcomer_ns, *nearest_ns]) - min([newcomer_ns, *nearest_ns]) < slop_ns:
        return nearest_ns

    first_ns, last_ns = newcomer_ns - slop_ns + 1, newcomer_ns
    later_starts = [[(first_ns, last_ns)] if first_ns <= last_ns else []]
    for stamps_ns in reversed(candidates):
        later_starts.append(_starts_that_reach(stamps_ns, newcomer_ns, slop_ns, later_starts[-1]))
    if not later_starts.pop():
        return None

    chosen = []
    for stamps_ns in candidates:
        starts = later_starts.pop()
        for stamp_ns in stamps_ns:
            narrowed = max(first_ns, stamp_ns - slop_ns + 1), min(last_ns, stamp_ns)
            if any(max(narrowed[0], low) <= min(narrowed[1], high) for low, high in starts):
                first_ns, last_ns = narrowed
                chosen.append(stamp_ns)
                break
    return chosen


def _starts_that_reach(
    stamps_ns: Sequence[int], newcomer_ns: int, slop_ns: int, starts: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """The part of `starts` (closed intervals) whose windows contain at least one of the stamps.

    Every window contains the newcomer, so it misses the topic only if it starts after the last stamp before the
    newcomer and ends before the first one after it.
    """
    before_ns = max((s for s in stamps_ns if s <= newcomer_ns), default=newcomer_ns - slop_ns)
    after_ns = min((s for s in stamps_ns if s >= newcomer_ns), default=newcomer_ns + slop_ns)
    gap_first, gap_last = before_ns + 1, after_ns - slop_ns
    if gap_first > gap_last:
        return starts
    below = [(low, min(high, gap_first - 1)) for low, high in starts if low < gap_first]
    above = [(max(low, gap_last + 1), high) for low, high in starts if high > gap_last]
    return below + above
