"""From a stream of undecoded messages to bundles of one moment, by the configured policy."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from pipeline.core.errors import ConfigError
from pipeline.core.frame import SensorBundle
from pipeline.core.messages import Drop, RawMessage
from pipeline.core.settings.sync import SyncConfig
from pipeline.stages.sync.approximate_time import ApproximateTime
from pipeline.stages.sync.approximate_time_python import ApproximateTimePython
from pipeline.stages.sync.nearest import Nearest
from pipeline.stages.sync.policy import OnItemDrop, Policy

__all__ = ["SyncStats", "synchronize"]


@dataclass(slots=True)
class SyncStats:
    """Counts of `synchronize` so far, updated as its bundles are consumed.

    Attributes:
        received: Number of messages by topic; 0 for a topic without messages.
        sets: Number of bundles.
        skew_max_ns: Largest spread of the stamps of a bundle.
        skew_total_ns: Sum of the spreads.
    """

    received: dict[str, int] = field(default_factory=dict)
    sets: int = 0
    skew_max_ns: int = 0
    skew_total_ns: int = 0

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
    on_drop: Callable[[Drop], None],
    flush: bool = True,
    stats: SyncStats | None = None,
) -> Iterator[SensorBundle]:
    """Bundles of one message per topic, lazily, in the order in which the policy finds them.

    Every message of `topics` ends up in one bundle or is reported to `on_drop`. Messages of other topics are ignored.

    Args:
        messages: In order of log time; equal times in order of (file, position).
        topics: Topics of each bundle, in this order.
        config: Policy and its parameters.
        reference: One of `topics`, whose message gives a bundle its stamp and log time.
        on_drop: Called for each message that is in no bundle, in a fixed order.
        flush: Whether to emit bundles that only the end of the recording makes certain; the live program in ROS does
            not.
        stats: Updated as bundles are consumed.

    Raises:
        ConfigError: `topics` is empty or names a topic twice, or the reference is not among them.
    """
    if not topics or len(set(topics)) < len(topics):
        raise ConfigError(f"sync: expected one or more distinct topics, found {', '.join(topics) or 'none'}")
    if reference not in topics:
        raise ConfigError(f"sync.reference: {reference!r} is not synchronised; choose one of {', '.join(topics)}")

    dropped_before: Counter[tuple[str, str]] = Counter()

    def drop(message: RawMessage, reason: str) -> None:
        dropped_before[message.topic, reason] += 1
        on_drop(Drop(message.topic, message.stamp_ns, reason))

    stats = SyncStats() if stats is None else stats
    policy = _policy(config, topics, topics.index(reference), drop)
    sets = _sets(messages, topics, policy, stats, flush)
    return _bundles(sets, topics, reference, dropped_before, stats)


def _bundles(
    sets: Iterable[tuple[RawMessage, ...]],
    topics: Sequence[str],
    reference: str,
    dropped_before: Counter[tuple[str, str]],
    stats: SyncStats,
) -> Iterator[SensorBundle]:
    for index, found in enumerate(sets):
        chosen = dict(zip(topics, found, strict=True))
        bundle = SensorBundle(
            index,
            chosen[reference].stamp_ns,
            chosen[reference].log_time_ns,
            chosen,
            dropped_before=dict(dropped_before),
        )
        dropped_before.clear()
        stats.count(bundle)
        yield bundle


def _sets(
    messages: Iterable[RawMessage], topics: Sequence[str], policy: Policy[RawMessage], stats: SyncStats, flush: bool
) -> Iterator[tuple[RawMessage, ...]]:
    index_of = {topic: index for index, topic in enumerate(topics)}
    stats.received.update(dict.fromkeys(topics, 0))
    for message in messages:
        topic = message.topic
        if topic in index_of:
            stats.received[topic] += 1
            yield from policy.add(index_of[topic], message.stamp_ns, message)
    if flush:
        yield from policy.flush()
    policy.close()


def _policy(
    config: SyncConfig, topics: Sequence[str], reference: int, on_drop: OnItemDrop[RawMessage]
) -> Policy[RawMessage]:
    slop_ns = _nanoseconds(config.slop_s)
    match config.policy:
        case "approximate_time":
            return ApproximateTime(
                len(topics),
                queue_size=config.queue_size,
                age_penalty=config.age_penalty,
                max_interval_ns=None if config.max_interval_s is None else _nanoseconds(config.max_interval_s),
                on_drop=on_drop,
            )
        case "approximate_time_python":
            return ApproximateTimePython(len(topics), queue_size=config.queue_size, slop_ns=slop_ns, on_drop=on_drop)
        case "nearest":
            return Nearest(topics, reference=reference, queue_size=config.queue_size, slop_ns=slop_ns, on_drop=on_drop)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9)
