"""Passes of the recorder's clock: where log times jump back within a file, and go over the same time once more.

A bag that was recorded with simulated time, while that began again, holds the same log times twice. In the order of log
time alone the messages of both would be mixed into one another. Small disorder, topics that were written one after the
other, and files that were joined in the wrong order are no passes: there, no topic covers a time twice.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import I64, Bools

MIN_JUMP_NS = 1_000_000_000
"""Minimum step back of a topic's log times that is no disorder."""

MIN_MESSAGES_BEFORE = 5
"""Messages of the topic before a jump that are needed to know its period."""

MAX_COMPARED = 20
"""Messages of the topic after a jump that are compared."""

MAX_JUMPS = 100
"""Jumps of topics that are examined: a shuffled file has as many as messages."""

MAX_DISTANCE_PERIODS = 1.5
"""Maximum distance, in periods, of a covered time from the nearest message."""


def pass_starts(log_times_ns: I64, topics: I64) -> Sequence[int]:
    """Rows at which the second and later passes begin, mostly none.

    Takes the log times (N,) in the order of the file, and the number of each message's topic.
    """
    if not len(log_times_ns):
        return ()
    behind_ns = np.maximum.accumulate(log_times_ns)
    behind_ns -= log_times_ns
    longest_ns = behind_ns.max()
    del behind_ns
    if longest_ns <= MIN_JUMP_NS:
        return ()
    by_topic = np.argsort(topics, kind="stable")
    befores, afters = by_topic[:-1], by_topic[1:]
    jumps = (topics[befores] == topics[afters]) & (log_times_ns[befores] - log_times_ns[afters] > MIN_JUMP_NS)
    rows = sorted(zip(afters[jumps].tolist(), befores[jumps].tolist(), strict=True))
    starts = [0]
    for row, before in rows[:MAX_JUMPS]:
        if before < starts[-1]:  # a topic that follows the jump of another one
            continue
        same = np.flatnonzero(topics == topics[row])
        same = same[same >= starts[-1]]
        if _covers(log_times_ns[same[same < row]], log_times_ns[same[same >= row][:MAX_COMPARED]]):
            starts.append(row)
    return starts[1:]


def _covers(before_ns: I64, after_ns: I64) -> bool:
    """Whether most of the times after a jump lie next to times before it."""
    if len(before_ns) < MIN_MESSAGES_BEFORE:
        return False
    known_ns = np.sort(before_ns)
    near_ns = MAX_DISTANCE_PERIODS * float(np.median(np.diff(known_ns)))
    right = np.clip(np.searchsorted(known_ns, after_ns), 1, len(known_ns) - 1)
    distance_ns = np.minimum(np.abs(known_ns[right] - after_ns), np.abs(known_ns[right - 1] - after_ns))
    covered: Bools = distance_ns <= near_ns
    return bool(covered.mean() > 0.5)
