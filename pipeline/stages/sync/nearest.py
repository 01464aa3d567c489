"""The nearest message of every topic to each message of a reference topic, one to one.

A message is never used twice, sets never cross, and the result does not depend on the interleaving of topics unless a
queue overflows. A message nearest to two reference messages goes to the nearer one, whichever arrived first.
"""

from bisect import insort
from collections.abc import Sequence
from typing import Generic, TypeVar

from pipeline.stages.sync.policy import DropReason, OnItemDrop

__all__ = ["Nearest"]

T = TypeVar("T")


class Nearest(Generic[T]):
    """One set per reference message that has a message of every other topic within slop.

    Reference messages are settled in order of their stamps, each once the following one is known and every other topic
    has reached that one, or a queue is full. Each takes, per topic, the nearest message after those already taken;
    ties go to the earlier stamp, then to the earlier arrival. A message that is nearest to the following reference
    message, and nearer to that one, is left to it.

    Args:
        topics: Topic names, for the drop reasons.
        reference: Index of the reference topic.
        queue_size: Messages held per topic.
        slop_ns: Largest distance to the reference message, inclusive.
        on_drop: Called for each message that is in no set.
    """

    def __init__(
        self, topics: Sequence[str], *, reference: int, queue_size: int, slop_ns: int, on_drop: OnItemDrop[T]
    ) -> None:
        self._topics = tuple(topics)
        self._reference = reference
        self._others = [topic for topic in range(len(topics)) if topic != reference]
        self._queues: list[list[tuple[int, T]]] = [[] for _ in topics]  # by stamp, then arrival
        self._newest_ns: list[int | None] = [None] * len(topics)
        self._settled_ns: list[int | None] = [None] * len(topics)
        self._queue_size = queue_size
        self._slop_ns = slop_ns
        self._on_drop = on_drop

    def add(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Add a message, and return the sets now certain."""
        settled_ns = self._settled_ns[topic]
        if settled_ns is not None and stamp_ns < settled_ns:
            self._on_drop(item, DropReason.TOO_LATE)
            return []
        queue = self._queues[topic]
        insort(queue, (stamp_ns, item), key=lambda queued: queued[0])
        self._newest_ns[topic] = queue[-1][0]
        sets: list[tuple[T, ...]] = []
        while self._next_is_certain():
            sets += self._settle_next()
        while len(queue) > self._queue_size:
            sets += self._make_room(topic)
        return sets

    def flush(self) -> Sequence[tuple[T, ...]]:
        """The sets of the reference messages that were still waiting."""
        sets: list[tuple[T, ...]] = []
        while self._queues[self._reference]:
            sets += self._settle_next()
        return sets

    def close(self) -> None:
        """Report all messages still held as dropped."""
        for topic, queue in enumerate(self._queues):
            self._drop_first(topic, len(queue), DropReason.END)

    def _next_is_certain(self) -> bool:
        """Whether the first two reference messages and all messages that could be near the first are known."""
        references = self._queues[self._reference]
        if len(references) < 2:
            return False
        following_ns = references[1][0]
        newest_ns = (self._newest_ns[topic] for topic in self._others)
        return all(stamp_ns is not None and stamp_ns >= following_ns for stamp_ns in newest_ns)

    def _settle_next(self) -> list[tuple[T, ...]]:
        """Remove the first reference message; its set, if it has a partner on every other topic."""
        stamp_ns, item = self._queues[self._reference].pop(0)
        self._settled_ns[self._reference] = stamp_ns
        partners: dict[int, int] = {}
        for topic in self._others:
            row = self._partner(topic, stamp_ns)
            if row is None:
                self._on_drop(item, f"no message of {self._topics[topic]} within slop")
                self._drop_unreachable()
                return []
            partners[topic] = row
        items = {self._reference: item}
        for topic, row in partners.items():
            self._drop_first(topic, row, DropReason.LEFT_OUT)
            self._settled_ns[topic], items[topic] = self._queues[topic].pop(0)
        self._drop_unreachable()
        return [tuple(items[topic] for topic in range(len(self._topics)))]

    def _partner(self, topic: int, stamp_ns: int) -> int | None:
        """Row in the topic's queue that the reference message at `stamp_ns` takes; None if there is none."""
        queue = self._queues[topic]
        rows = range(len(queue))
        references = self._queues[self._reference]
        if references and queue:
            following_ns = references[0][0]
            wanted = min(rows, key=lambda row: abs(queue[row][0] - following_ns))
            wanted_ns = queue[wanted][0]
            if abs(wanted_ns - following_ns) < abs(wanted_ns - stamp_ns):
                rows = range(wanted)
        nearest = min(rows, key=lambda row: abs(queue[row][0] - stamp_ns), default=None)
        if nearest is None or abs(queue[nearest][0] - stamp_ns) > self._slop_ns:
            return None
        return nearest

    def _make_room(self, topic: int) -> list[tuple[T, ...]]:
        """Settle a reference message with the messages known so far; without one, drop the topic's oldest message."""
        references = self._queues[self._reference]
        if not references:
            self._drop_first(topic, 1, DropReason.QUEUE_FULL)
            return []
        if self._queues[topic][0][0] < references[0][0] - self._slop_ns:
            self._drop_first(topic, 1, DropReason.NO_REFERENCE)
            return []
        return self._settle_next()

    def _drop_unreachable(self) -> None:
        """Drop messages too old for the next reference message and thus for all later ones."""
        references = self._queues[self._reference]
        if not references:
            return
        oldest_ns = references[0][0] - self._slop_ns
        for topic in self._others:
            unreachable = sum(stamp_ns < oldest_ns for stamp_ns, _ in self._queues[topic])
            self._drop_first(topic, unreachable, DropReason.NO_REFERENCE)

    def _drop_first(self, topic: int, count: int, reason: DropReason) -> None:
        dropped = self._queues[topic][:count]
        del self._queues[topic][:count]
        for _, item in dropped:
            self._on_drop(item, reason)
