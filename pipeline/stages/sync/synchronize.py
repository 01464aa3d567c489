"""Bundles of the messages of one moment, from a stream of undecoded messages."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from lidcam.pipeline.core.errors import ConfigError, RecordingError
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.sync import SyncConfig
from lidcam.pipeline.stages.sync.approximate_time import ApproximateTime
from lidcam.pipeline.stages.sync.attendance import Attendance
from lidcam.pipeline.stages.sync.liveness import Liveness
from lidcam.pipeline.stages.sync.partial_sets import FoundSet, PartialSets

MAX_INTERVAL_S = 0.1
"""Largest spread of the required topics' stamps by `auto`, seconds, but for slow topics."""


@dataclass(slots=True)
class SyncStats:
    """Counts of `synchronize` so far, updated as its bundles are consumed; those of further parts are added."""

    # Number of messages by topic; 0 for a topic without messages
    received: dict[str, int] = field(default_factory=dict)
    sets: int = 0  # Number of bundles
    skew_max_ns: int = 0  # Largest spread of the stamps of a bundle
    skew_total_ns: int = 0  # Sum of the spreads
    # Topics that were missing, and when they were silent
    attendance: Attendance = field(default_factory=Attendance, compare=False)

    @property
    def skew_mean_ns(self) -> float:
        """Mean spread of the stamps of a bundle; 0 without bundles."""
        return self.skew_total_ns / self.sets if self.sets else 0.0

    def count(self, bundle: SensorBundle) -> None:
        """Add one bundle."""
        self.sets += 1
        self.skew_max_ns = max(self.skew_max_ns, bundle.skew_ns)
        self.skew_total_ns += bundle.skew_ns


def synchronize(
    messages: Iterable[RawMessage],
    topics: Sequence[str],
    config: SyncConfig,
    *,
    reference: str,
    required: Sequence[str] | None = None,
    on_drop: Callable[[Drop], None],
    stats: SyncStats | None = None,
    max_waiting_bytes: int | None = None,
) -> Iterator[SensorBundle]:
    """Bundles of the messages of one moment, lazily, in the order in which they are found.

    Every message of `topics` ends up in one bundle or is reported to `on_drop`. Messages of other topics are ignored.

    Args:
        messages: In order of log time; equal times in order of (file, position).
        topics: Topics of the bundles, in this order.
        config: Limits of queues and distances.
        reference: One of `topics`, whose message gives a bundle its stamp and log time while it is alive.
        required: Those of `topics` that a bundle needs while they are alive; the others join it (`PartialSets`). None:
            every bundle has a message of each topic, as in message_filters.
        on_drop: Called for each message that is in no bundle, in a fixed order.
        stats: Updated as bundles are consumed; the first bundle's index is the number of its sets.
        max_waiting_bytes: Maximum size of all messages that wait for one another.

    Raises:
        RecordingError: more bytes wait.
        ConfigError: `topics` is empty or names a topic twice.
    """
    if not topics or len(set(topics)) < len(topics):
        raise ConfigError(f"sync: expected one or more distinct topics, found {', '.join(topics) or 'none'}")

    dropped_before: Counter[tuple[str, str]] = Counter()
    waiting = _Waiting(max_waiting_bytes)

    def drop(message: RawMessage, reason: str) -> None:
        waiting.bytes -= len(message.data)
        dropped_before[message.topic, reason] += 1
        on_drop(Drop(message.topic, message.stamp_ns, reason))

    stats = SyncStats() if stats is None else stats
    for topic in topics:
        stats.received.setdefault(topic, 0)
    interval_s = MAX_INTERVAL_S if config.max_interval_s == "auto" else config.max_interval_s
    max_interval_ns = None if interval_s is None else _nanoseconds(interval_s)
    finder: _FullSets | PartialSets
    if required is None:
        policy = ApproximateTime(
            len(topics), queue_size=config.queue_size, max_interval_ns=max_interval_ns, on_drop=drop
        )
        finder = _FullSets(topics, policy, reference)
    else:
        finder = PartialSets(
            topics,
            required=required,
            reference=reference,
            queue_size=config.queue_size,
            max_interval_ns=max_interval_ns,
            slop_ns=_nanoseconds(config.slop_s),
            liveness=Liveness(len(topics), silent_after_ns=_nanoseconds(config.silent_after_s)),
            attendance=stats.attendance,
            on_drop=drop,
        )
    sets = _sets(_counted(messages, stats.received, waiting), finder)
    return _bundles(sets, topics, dropped_before, stats, waiting, config.every)


@dataclass(slots=True)
class _Waiting:
    """Size of the messages that are in no bundle yet, and its limit."""

    max_bytes: int | None
    bytes: int = 0


def _counted(messages: Iterable[RawMessage], received: dict[str, int], waiting: _Waiting) -> Iterator[RawMessage]:
    """The messages of the topics in `received`, counted there and among those that wait."""
    for message in messages:
        topic = message.channel.topic
        if topic in received:
            received[topic] += 1
            waiting.bytes += len(message.data)
            if waiting.max_bytes is not None and waiting.bytes > waiting.max_bytes:
                raise RecordingError(
                    f"{topic}: messages of more than {waiting.max_bytes >> 20} MiB wait for those of other topics: "
                    "lower sync.queue_size, exclude a topic, or raise limit_scale"
                )
            yield message


class _FullSets:
    """Sets that each have a message of every topic; used as `PartialSets`."""

    def __init__(self, topics: Sequence[str], policy: ApproximateTime[RawMessage], reference: str) -> None:
        self._place = {topic: index for index, topic in enumerate(topics)}
        self._policy, self._reference = policy, self._place[reference]

    def add_message(self, message: RawMessage) -> list[FoundSet]:
        """Add the next message, and return the sets now certain."""
        return self._found(self._policy.add_item(self._place[message.topic], message.stamp_ns, message))

    def flush(self) -> list[FoundSet]:
        """The sets that become certain because no more messages follow."""
        return self._found(self._policy.flush())

    def close(self) -> None:
        """Report all messages still held as dropped."""
        self._policy.close()

    def _found(self, sets: Sequence[tuple[RawMessage, ...]]) -> list[FoundSet]:
        return [FoundSet(messages[self._reference], dict(enumerate(messages))) for messages in sets]


def _sets(messages: Iterable[RawMessage], finder: _FullSets | PartialSets) -> Iterator[FoundSet]:
    for message in messages:
        yield from finder.add_message(message)
    yield from finder.flush()
    finder.close()


def _bundles(
    sets: Iterable[FoundSet],
    topics: Sequence[str],
    dropped_before: Counter[tuple[str, str]],
    stats: SyncStats,
    waiting: _Waiting,
    every: int,
) -> Iterator[SensorBundle]:
    for reference, by_topic in sets:
        messages = {topic: by_topic[index] for index, topic in enumerate(topics) if index in by_topic}
        waiting.bytes -= sum(len(message.data) for message in messages.values())
        is_kept = stats.sets % every == 0  # of the others nothing is missed
        lacking = [topic for topic in topics if topic not in messages] if is_kept else []
        if is_kept:
            stats.attendance.meet(messages)
        bundle = SensorBundle(
            stats.sets,
            reference.stamp_ns,
            reference.log_time_ns,
            messages,
            dropped_before=dict(dropped_before),
            missing=stats.attendance.missing(lacking, reference.log_time_ns),
        )
        dropped_before.clear()
        stats.count(bundle)
        yield bundle


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9)
