"""Clocks that were not set: the stamps of such a sensor are moved to the time of the others.

Lidars without a time source stamp by the time since their power was switched on, and computers without one by any time.
When their messages were recorded tells by how much they are off, up to the delay of the recording.
"""

from collections.abc import Iterable, Mapping
from itertools import islice

import numpy as np

from lidcam.readers.recording import Recording

MAX_AHEAD_NS, MAX_BEHIND_NS = 1_000_000_000, 10_000_000_000
"""Maximum offset of a clock ahead of, and behind, most others, nanoseconds; some messages are recorded seconds late."""

CHECKED = 5
"""Number of messages whose delays have to agree: a clock may be set just after its first message."""


def usual_delay_ns(delays_ns: Iterable[int]) -> int:
    """The delay, log time minus stamp, that most are close to: if there are any, of those that can be a delay.

    Of several the first; 0 of none.
    """
    known = [*delays_ns]
    possible = [delay for delay in known if not is_off(delay, 0)] or known
    return max(possible, key=lambda one: sum(abs(one - other) <= MAX_AHEAD_NS for other in possible), default=0)


def is_off(delay_ns: int, usual_ns: int) -> bool:
    """Whether the clock of messages with a delay is not the one of those with the usual delay."""
    return not -MAX_AHEAD_NS <= delay_ns - usual_ns <= MAX_BEHIND_NS


def stamped_delay_ns(recording: Recording, topic: str) -> int | None:
    """The delay of the first message with a stamp; None if the first stamps are all 0, and log times are used."""
    first = islice(recording.messages([topic]), CHECKED)
    return next((message.log_time_ns - message.stamp_ns for message in first if message.stamp_ns), None)


def clock_offsets(recording: Recording, delays_ns: Mapping[str, int], usual_ns: int) -> dict[str, int]:
    """Offsets of the stamps of topics whose clock is off and runs on steadily, nanoseconds by topic.

    `delays_ns` has the delay of a message of each topic; `usual_ns` is the usual delay.
    """
    offsets_ns: dict[str, int] = {}
    for topic in [topic for topic, delay_ns in delays_ns.items() if is_off(delay_ns, usual_ns)]:
        first = islice(recording.messages([topic]), CHECKED)
        delays = np.array([message.log_time_ns - message.stamp_ns for message in first if message.stamp_ns], np.int64)
        if np.ptp(delays) <= MAX_AHEAD_NS:
            offsets_ns[topic] = usual_ns - int(np.sort(delays)[len(delays) // 2])
    return offsets_ns


def clock_note(name: str, offset_ns: int) -> str:
    """The note about a sensor whose stamps are moved."""
    side = "ahead of" if offset_ns > 0 else "behind"
    return (
        f"{name}: its clock is {abs(offset_ns) / 1e9:.1f} s {side} the others; its stamps are moved to when they were "
        "recorded, right to about 0.1 s; give its exact time_offset_ms in a rig file (--rig)"
    )
