"""The rules of message_filters' Python ApproximateTimeSynchronizer, with a search in polynomial time.

Source: ros_comm, message_filters/__init__.py. Greedy and dependent on the order of arrival: the first set that fits the
newest message is emitted at once, so sets may come out of time order. ROS tries combinations one by one, exponentially
many in the number of topics; here the same combination is found without trying those that cannot fit.
"""

from collections.abc import Sequence
from typing import Generic, TypeVar

from lidcam.pipeline.stages.sync.policy import DropReason, OnItemDrop

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

    def add_item(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
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

    Chosen one after another, and none is revised: a stamp is taken only if the topics after it can still be completed,
    that is if a span of slop around the stamps chosen so far has a stamp of each of them.

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
    if not _can_be_completed(newcomer_ns, newcomer_ns, candidates, slop_ns):
        return None
    low_ns = high_ns = newcomer_ns
    chosen: list[int] = []
    for place, stamps_ns in enumerate(candidates):
        later = candidates[place + 1 :]
        for stamp_ns in stamps_ns:
            low, high = min(low_ns, stamp_ns), max(high_ns, stamp_ns)
            if _can_be_completed(low, high, later, slop_ns):
                low_ns, high_ns = low, high
                chosen.append(stamp_ns)
                break
    return chosen


def _can_be_completed(low_ns: int, high_ns: int, topics: Sequence[Sequence[int]], slop_ns: int) -> bool:
    """Whether a span of less than slop holds both stamps and a stamp of each topic."""
    starts = [low_ns, *(stamp_ns for stamps_ns in topics for stamp_ns in stamps_ns if stamp_ns < low_ns)]
    return any(
        high_ns < start_ns + slop_ns
        and all(any(start_ns <= stamp_ns < start_ns + slop_ns for stamp_ns in stamps_ns) for stamps_ns in topics)
        for start_ns in starts
    )
