"""The contents of a recording by topic: counts, rates, gaps. Reads headers only."""

import logging
from array import array
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.messages import RawMessage, time_fault
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.deserialize import definition_problem
from lidcam.readers.recording import Recording, TopicInfo

logger = logging.getLogger(__name__)

MIN_GAP_PERIODS = 2.5
"""Minimum length of a gap, in periods: one lost message makes two."""

MAX_UNEVEN_SHARE = 0.5
"""Maximum distance of the middle half of the periods from their median, as a share of it, of evenly spaced stamps:
those of sensors are, even with losses; events and transforms of several senders have no period."""


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """Statistics of one topic."""

    topic: str  # Topic name
    msgtype: str  # Type name
    count: int  # Number of messages
    rate_hz: float  # 1 / median period of evenly spaced stamps, else 1 / mean period; 0 with fewer than two stamps
    gaps: int  # Number of pauses longer than 2.5 periods; 0 if the stamps are not evenly spaced
    longest_gap_s: float  # Longest pause between two stamps
    delay_s: float  # Median of log time minus stamp: how late the messages were recorded
    backwards: int  # Number of messages whose stamp lies before that of the one recorded before
    # Why its messages cannot be read, or what is wrong with its definition or its stamps; else empty. Stamps and log
    # times that cannot be times are in none of the figures
    problem: str = ""


def survey(
    recording: Recording,
    *,
    stop_ns: int | None = None,
    limits: RecordingLimits = DEFAULT_LIMITS,
    watch: Callable[[Iterator[RawMessage]], None] = lambda _: None,
) -> tuple[TopicSurvey, ...]:
    """All topics by name; with `stop_ns`, everything but the counts covers only messages recorded before that time.

    Sixteen bytes a message are held. All messages are read, to find damage, but only the times of the first
    `limits.max_messages_in_memory` are used; a warning says so. `watch` gets the messages as they are read, so that
    they are read only once.
    """
    times: defaultdict[str, array[int]] = defaultdict(lambda: array("q"))
    faults: dict[str, tuple[str, int]] = {}
    counts: Counter[str] = Counter()

    def counted() -> Iterator[RawMessage]:
        left = limits.max_messages_in_memory
        for message in recording.messages(stop_ns=stop_ns):
            topic = message.channel.topic
            counts[topic] += 1
            if fault := time_fault(message.stamp_ns) or time_fault(message.log_time_ns):
                first, count = faults.get(topic, (fault, 0))
                faults[topic] = first, count + 1
            elif left:
                left -= 1
                times[topic].extend((message.stamp_ns, message.log_time_ns))
            yield message

    messages = counted()
    watch(messages)
    deque(messages, maxlen=0)
    if counts.total() > limits.max_messages_in_memory:
        logger.warning(
            "rates, gaps and delays are those of the first %d messages: raise limit_scale",
            limits.max_messages_in_memory,
        )
    surveys = []
    for info in sorted(recording.topics, key=lambda info: info.topic):
        known = np.frombuffer(times.pop(info.topic, array("q")), np.int64).reshape(-1, 2)
        surveys.append(_topic_survey(info, known, counts[info.topic], faults.get(info.topic, ("", 0))))
    return tuple(surveys)


def _problem(info: TopicInfo, faults: tuple[str, int]) -> str:
    if info.unreadable or not info.message_count:
        return info.unreadable
    problem = next((problem for channel in info.channels if (problem := definition_problem(channel))), "")
    first, count = faults
    if problem or not count:
        return problem
    return f"{count} stamps or log times cannot be times: {first}"


def _topic_survey(info: TopicInfo, times_ns: I64, count: int, faults: tuple[str, int]) -> TopicSurvey:
    """The statistics of a topic from the stamps and log times (N, 2) of its first messages."""
    stamps_ns, log_ns = times_ns.T
    steps_s = np.diff(stamps_ns) / 1e9
    forward_s = steps_s[steps_s > 0]
    period_s, is_even = _period(forward_s)
    return TopicSurvey(
        topic=info.topic,
        msgtype=info.msgtype,
        count=count if info.gathered_from else info.message_count,
        rate_hz=1 / period_s if period_s else 0.0,
        gaps=int((forward_s > MIN_GAP_PERIODS * period_s).sum()) if is_even else 0,
        longest_gap_s=float(forward_s.max(initial=0.0)),
        delay_s=float(np.median(log_ns - stamps_ns)) / 1e9 if len(times_ns) else 0.0,
        backwards=int((steps_s < 0).sum()),
        problem=_problem(info, faults),
    )


def _period(steps_s: F64) -> tuple[float, bool]:
    """Typical time between two stamps, 0 without steps, and whether they are evenly spaced."""
    if not len(steps_s):
        return 0.0, False
    mean_s = float(steps_s.mean())
    low_s, median_s, high_s = np.quantile(steps_s, [0.25, 0.5, 0.75]).tolist()
    if max(median_s - low_s, high_s - median_s) <= MAX_UNEVEN_SHARE * median_s:
        return median_s, True
    return mean_s, False
