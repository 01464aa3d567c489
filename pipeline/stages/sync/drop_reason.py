"""The reasons for which synchronisation drops messages."""

from collections.abc import Callable
from enum import StrEnum
from typing import TypeVar

T = TypeVar("T")


class DropReason(StrEnum):
    """Why a message is in no set."""

    QUEUE_FULL = "the queue was full before a set was complete; a larger sync.queue_size holds more"
    TOO_FAR = "no partner within the allowed interval"
    AFTER_OVERFLOW = "its partner may be among the messages that a full queue lost"
    LEFT_OUT = "another message of its topic is nearer in time to the other sensors"
    TOO_LATE = "arrived after newer messages had taken its place; a larger sync.queue_size waits longer"
    NO_REFERENCE = "no reference message within slop"
    END = "no partner before the end of the recording"


OnItemDrop = Callable[[T, str], None]
"""Called with each dropped item and the reason."""
