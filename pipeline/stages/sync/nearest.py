"""The nearest message of every topic to each message of a reference topic, one to one, as a policy."""

from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

from pipeline.stages.sync.nearest_partners import NearestPartners
from pipeline.stages.sync.policy import OnItemDrop

__all__ = ["Nearest"]

T = TypeVar("T")


class Nearest(Generic[T]):
    """One set per reference message that has a message of every other topic within slop; see `NearestPartners`.

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
        self._reference = reference
        self._topic_count = len(topics)
        others = [topic for topic in range(len(topics)) if topic != reference]
        self._partners: NearestPartners[T, T] = NearestPartners(
            topics,
            required=others,
            awaited=others,
            queue_size=queue_size,
            max_references=queue_size,
            slop_ns=slop_ns,
            on_drop=on_drop,
            on_reference_drop=on_drop,
        )

    def add(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Add a message, and return the sets now certain."""
        if topic == self._reference:
            return self._sets(self._partners.add_reference(stamp_ns, item))
        return self._sets(self._partners.add(topic, stamp_ns, item))

    def flush(self) -> Sequence[tuple[T, ...]]:
        """The sets of the reference messages that were still waiting."""
        return self._sets(self._partners.flush())

    def close(self) -> None:
        """Report all messages still held as dropped."""
        self._partners.close()

    def _sets(self, settled: Sequence[tuple[T, Mapping[int, T]]]) -> list[tuple[T, ...]]:
        return [
            tuple(item if topic == self._reference else partners[topic] for topic in range(self._topic_count))
            for item, partners in settled
        ]
