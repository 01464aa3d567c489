"""The protocol of synchronisation policies, and the reasons for which they drop messages."""

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Protocol, TypeVar

T = TypeVar("T")


class DropReason(StrEnum):
    """Why a message is in no set. For a reference message, `Nearest` names the topic without a partner instead."""

    QUEUE_FULL = "the queue was full before a set was complete; a larger sync.queue_size holds more"
    TOO_FAR = "no partner within the allowed interval"
    AFTER_OVERFLOW = "its partner may be among the messages that a full queue lost"
    LEFT_OUT = "left out of a better set"
    TOO_LATE = "arrived after newer messages had taken its place; a larger sync.queue_size waits longer"
    NO_REFERENCE = "no reference message within slop"
    END = "no partner before the end of the recording"


OnItemDrop = Callable[[T, str], None]
"""Called with each dropped item and the reason."""


class Policy(Protocol[T]):
    """Finds sets of items, one of each topic; every item ends up in one set or is reported as dropped.

    At most `queue_size` items of each topic are held between calls.
    """

    def add_item(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Add the next item of a topic (by index), and return the sets now certain, items in order of topics."""

    def flush(self) -> Sequence[tuple[T, ...]]:
        """The sets that become certain because no more items follow."""

    def close(self) -> None:
        """Report all items still held as dropped."""
