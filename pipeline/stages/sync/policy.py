"""What every policy has in common: the way it is fed, and the reasons for which it lets a message go."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol, TypeVar

__all__ = ["DropReason", "OnItemDrop", "Policy"]

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)


class DropReason(StrEnum):
    """Why a message is in no set. `Nearest` also names the topic that a reference message found nothing on."""

    QUEUE_FULL = "the queue was full before a set was complete"
    TOO_FAR = "no partner within the allowed interval"
    AFTER_OVERFLOW = "its partner may be among the messages that a full queue lost"
    LEFT_OUT = "left out of a better set"
    REPLACED = "replaced by a later message of the same stamp"
    TOO_LATE = "arrived after newer messages had taken its place"
    NO_REFERENCE = "no reference message within slop"
    END = "no partner before the end of the recording"


class OnItemDrop(Protocol[T_contra]):
    """Told of each item that takes no part."""

    def __call__(self, item: T_contra, reason: str, /) -> None:
        """Count `item` as dropped for `reason`."""


class Policy(Protocol[T]):
    """Finds sets of items, one of each topic; every item ends in one set or is reported as dropped.

    At most `queue_size` items of each topic are held between calls.
    """

    def add(self, topic: int, stamp_ns: int, item: T) -> Sequence[tuple[T, ...]]:
        """Take the next item of a topic (by index); the sets that are certain now, items in order of topics."""

    def flush(self) -> Sequence[tuple[T, ...]]:
        """The sets that become certain because nothing follows."""

    def close(self) -> None:
        """Report everything still held as dropped."""
