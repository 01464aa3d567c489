"""The nearest item of every topic to each reference item, one to one.

An item is never used twice, sets never cross, and the result does not depend on the interleaving of topics unless a
queue overflows. An item nearest to two reference items goes to the nearer one, whichever arrived first.
"""

from bisect import insort
from collections.abc import Collection, Sequence
from typing import Generic, TypeVar

from lidcam.pipeline.stages.sync.drop_reason import DropReason, OnItemDrop

R = TypeVar("R")
T = TypeVar("T")


class NearestPartners(Generic[R, T]):
    """For each reference item, its partners: by topic, the nearest item within slop.

    Reference items are resolved in the order of their stamps, each as soon as a later one is known and every awaited
    topic has reached that one, or a queue is full. Each takes, per topic, the nearest item after those already taken;
    ties go to the earlier stamp, then to the earlier arrival. An item that is nearest to the next later reference item,
    and nearer to that one, is left to it.

    Args:
        topic_count: Number of topics.
        queue_size: Items held per topic.
        max_references: Reference items held.
        slop_ns: Largest distance to the reference item, inclusive.
        on_drop: Called for each item that is no partner.
        on_reference_drop: Called for each reference item that arrived too late.
    """

    def __init__(
        self,
        topic_count: int,
        *,
        queue_size: int,
        max_references: int,
        slop_ns: int,
        on_drop: OnItemDrop[T],
        on_reference_drop: OnItemDrop[R],
    ) -> None:
        self._awaited: tuple[int, ...] = ()  # until `wait_for` says otherwise
        self._references: list[tuple[int, R, Collection[int]]] = []  # by stamp, then arrival, as the queues
        self._queues: list[list[tuple[int, T]]] = [[] for _ in range(topic_count)]
        self._newest_ns: list[int | None] = [None] * topic_count
        self._taken_ns: list[int | None] = [None] * topic_count
        self._resolved_ns: int | None = None
        self._queue_size = queue_size
        self._max_references = max_references
        self._slop_ns = slop_ns
        self._on_drop = on_drop
        self._on_reference_drop = on_reference_drop

    def add_reference(self, stamp_ns: int, item: R, complete: Collection[int] = ()) -> list[tuple[R, dict[int, T]]]:
        """Add a reference item, and return those now resolved with their partners by topic.

        Args:
            stamp_ns: Its stamp.
            item: The item.
            complete: Topics that it needs no partner of.
        """
        if self._resolved_ns is not None and stamp_ns < self._resolved_ns:
            self._on_reference_drop(item, DropReason.TOO_LATE)
            return []
        insort(self._references, (stamp_ns, item, complete), key=lambda queued: queued[0])
        resolved = self._resolve_certain()
        while len(self._references) > self._max_references:
            resolved += self._resolve_next()
        return resolved

    def add_item(self, topic: int, stamp_ns: int, item: T) -> list[tuple[R, dict[int, T]]]:
        """Add an item, and return the reference items now resolved with their partners by topic."""
        if self._is_too_late(topic, stamp_ns):
            self._on_drop(item, DropReason.TOO_LATE)
            return []
        queue = self._queues[topic]
        insort(queue, (stamp_ns, item), key=lambda queued: queued[0])
        self._newest_ns[topic] = queue[-1][0]
        resolved = self._resolve_certain() if len(self._references) > 1 else []
        while len(queue) > self._queue_size:
            resolved += self._make_room(topic)
        return resolved

    def wait_for(self, topics: Collection[int]) -> list[tuple[R, dict[int, T]]]:
        """Wait for these topics from now on, and return the reference items resolved thereby."""
        self._awaited = tuple(topics)
        return self._resolve_certain()

    def take_after(self, topic: int, stamp_ns: int | None) -> list[T]:
        """Remove and return the items of a topic with later stamps, or all of them, in order of their stamps."""
        queue = self._queues[topic]
        first = 0 if stamp_ns is None else sum(queued_ns <= stamp_ns for queued_ns, _ in queue)
        taken = [item for _, item in queue[first:]]
        del queue[first:]
        return taken

    def flush(self) -> list[tuple[R, dict[int, T]]]:
        """Resolve the reference items that were still waiting."""
        resolved: list[tuple[R, dict[int, T]]] = []
        while self._references:
            resolved += self._resolve_next()
        return resolved

    def close(self) -> None:
        """Report all items still held as dropped, after `flush`."""
        for topic, queue in enumerate(self._queues):
            self._drop_first(topic, len(queue), DropReason.END)

    def _is_too_late(self, topic: int, stamp_ns: int) -> bool:
        """Whether a later item of the topic is taken, or all reference items that it could reach are resolved."""
        taken_ns, settled_ns = self._taken_ns[topic], self._resolved_ns
        is_passed = taken_ns is not None and stamp_ns < taken_ns
        return is_passed or (settled_ns is not None and stamp_ns < settled_ns - self._slop_ns)

    def _resolve_certain(self) -> list[tuple[R, dict[int, T]]]:
        resolved: list[tuple[R, dict[int, T]]] = []
        while self._next_is_certain():
            resolved += self._resolve_next()
        return resolved

    def _next_is_certain(self) -> bool:
        """Whether a later reference item and all items that could be near the first are known."""
        following_ns = self._later_reference_ns(self._references[0][0]) if self._references else None
        if following_ns is None:
            return False
        newest_ns = (self._newest_ns[topic] for topic in self._awaited)
        return all(known_ns is not None and known_ns >= following_ns for known_ns in newest_ns)

    def _resolve_next(self) -> list[tuple[R, dict[int, T]]]:
        """Remove the first reference item, with its partners."""
        stamp_ns, item, complete = self._references.pop(0)
        self._resolved_ns = stamp_ns
        partners: dict[int, T] = {}
        for topic, queue in enumerate(self._queues):
            row = self._partner(topic, stamp_ns) if queue and topic not in complete else None
            if row is not None:
                self._drop_first(topic, row, DropReason.LEFT_OUT)
                self._taken_ns[topic], partners[topic] = queue.pop(0)
        self._drop_unreachable()
        return [(item, partners)]

    def _partner(self, topic: int, stamp_ns: int) -> int | None:
        """Row in the topic's queue that the reference item at `stamp_ns` takes; None if there is none."""
        queue, count = self._queues[topic], len(self._queues[topic])
        following_ns = self._later_reference_ns(stamp_ns)
        if following_ns is not None:
            wanted = _nearest_row(queue, count, following_ns)
            wanted_ns = queue[wanted][0]
            if abs(wanted_ns - following_ns) < abs(wanted_ns - stamp_ns):
                count = wanted
        if not count:
            return None
        nearest = _nearest_row(queue, count, stamp_ns)
        return nearest if abs(queue[nearest][0] - stamp_ns) <= self._slop_ns else None

    def _later_reference_ns(self, stamp_ns: int) -> int | None:
        """Stamp of the next reference item that is later, not equal; None if none is known.

        Of items with equal stamps none is nearer to anything, so they do not tell where the reach of the first ends.
        """
        return next((later_ns for later_ns, _, _ in self._references if later_ns > stamp_ns), None)

    def _make_room(self, topic: int) -> list[tuple[R, dict[int, T]]]:
        """Resolve a reference item with the items known so far; without one, drop the topic's oldest item."""
        if not self._references:
            self._drop_first(topic, 1, DropReason.QUEUE_FULL)
            return []
        if self._queues[topic][0][0] < self._references[0][0] - self._slop_ns:
            self._drop_first(topic, 1, DropReason.NO_REFERENCE)
            return []
        return self._resolve_next()

    def _drop_unreachable(self) -> None:
        """Drop items too old for the next reference item and thus for all later ones."""
        if not self._references:
            return
        oldest_ns = self._references[0][0] - self._slop_ns
        for topic, queue in enumerate(self._queues):
            self._drop_first(topic, sum(stamp_ns < oldest_ns for stamp_ns, _ in queue), DropReason.NO_REFERENCE)

    def _drop_first(self, topic: int, count: int, reason: DropReason) -> None:
        dropped = self._queues[topic][:count]
        del self._queues[topic][:count]
        for _, item in dropped:
            self._on_drop(item, reason)


def _nearest_row(queue: Sequence[tuple[int, object]], count: int, stamp_ns: int) -> int:
    """The first of the rows nearest to a stamp, among the first `count` of a queue that is ordered by stamp."""
    row, least_ns = 0, abs(queue[0][0] - stamp_ns)
    for other in range(1, count):
        distance_ns = abs(queue[other][0] - stamp_ns)
        if distance_ns > least_ns:
            break
        if distance_ns < least_ns:
            row, least_ns = other, distance_ns
    return row
