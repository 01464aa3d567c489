"""Sets of the messages of one moment, without those of the sensors that are silent.

The policy runs over the required topics that are alive. All other topics join its sets, each with the message nearest
to the reference message. When a topic falls silent or comes back, the required topics change: the policy then restarts
with the messages that are in no set yet.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.stages.sync.approximate_time import ApproximateTime
from lidcam.pipeline.stages.sync.attendance import Attendance
from lidcam.pipeline.stages.sync.drop_reason import OnItemDrop
from lidcam.pipeline.stages.sync.liveness import MAX_PERIODS, Liveness
from lidcam.pipeline.stages.sync.nearest import NearestPartners


class Item(NamedTuple):
    """A message and its number in the order of arrival."""

    number: int
    message: RawMessage


class FoundSet(NamedTuple):
    """The messages of one moment."""

    reference: RawMessage  # The one whose stamp the frame takes
    by_topic: Mapping[int, RawMessage]  # All, by the topic's index


class PartialSets:
    """Finds sets; every message ends up in one set or is reported as dropped.

    Args:
        topics: All topics. If no required one is alive, the first of these that is alive takes its place.
        required: Topics that a set needs while they are alive.
        reference: Topic whose messages are the reference while it is alive and required; else it is the first required
            one that is alive.
        queue_size: Messages held per required topic, and sets that wait for their partners; twice as many messages are
            held per other topic.
        max_interval_ns: Largest spread of the required topics' messages; None for no bound.
        slop_ns: Largest distance of the other topics' messages to the reference message.
        liveness: Of `topics`.
        attendance: Records when topics fall silent and come back.
        on_drop: Called for each message that is in no set.
    """

    def __init__(
        self,
        topics: Sequence[str],
        *,
        required: Sequence[str],
        reference: str,
        queue_size: int,
        max_interval_ns: int | None,
        slop_ns: int,
        liveness: Liveness,
        attendance: Attendance,
        on_drop: OnItemDrop[RawMessage],
    ) -> None:
        self._topics = tuple(topics)
        self._index = {topic: index for index, topic in enumerate(topics)}
        self._required = [self._index[topic] for topic in required]
        self._preferred = self._index[reference]
        self._queue_size, self._max_interval_ns = queue_size, max_interval_ns
        self._slop_ns = slop_ns
        self._liveness = liveness
        self._attendance = attendance
        self._on_drop = on_drop

        self._late: set[int] = set()
        self._entering: set[int] = set()
        self._last_ns: int | None = None
        self._count = 0
        self._is_changing = False
        self._held: list[dict[int, Item]] = [{} for _ in topics]  # by the policy, by number
        self._core: tuple[int, ...] = ()
        self._place: dict[int, int] = {}
        self._reference = self._preferred
        self._policy: ApproximateTime[Item]
        self._partners: NearestPartners[tuple[Item, ...], Item] = NearestPartners(
            len(topics),
            queue_size=2 * queue_size,  # the policy may hold as many reference messages as the partners do
            max_references=queue_size,
            slop_ns=slop_ns,
            on_drop=lambda item, reason: on_drop(item.message, reason),
            on_reference_drop=self._drop_set,
        )
        self._choose_core()

    def add_message(self, message: RawMessage) -> list[FoundSet]:
        """Add the next message, and return the sets now certain."""
        topic = self._index[message.channel.topic]
        found: list[FoundSet] = []
        if silent := self._liveness.advance(message.log_time_ns):
            self._note_silent(silent)
            found += self._choose_core()
        is_first = self._liveness.heard_ns(topic) is None  # in this part: it may have been silent in the one before
        came_back = self._liveness.hear(topic, message.stamp_ns)
        if came_back or is_first:
            self._attendance.come_back(message.topic, message.log_time_ns)
        has_caught_up = topic in self._late and self._is_worth_waiting_for(message.stamp_ns)
        if has_caught_up:
            self._late.discard(topic)
        if came_back or has_caught_up:
            found += self._choose_core(message)
        if topic in self._place and len(self._held[topic]) >= self._queue_size:
            oldest_ns = min(item.message.stamp_ns for item in self._held[topic].values())
            found += self._go_on_without(self._behind(oldest_ns))  # no queue of this size can wait for them
        self._count += 1
        return found + self._insert(topic, Item(self._count, message))

    def flush(self) -> list[FoundSet]:
        """The sets that become certain because no more messages follow."""
        found: list[FoundSet] = []
        if silent := self._liveness.end():
            self._note_silent(silent)
            found += self._choose_core()
        newest_ns = max((self._liveness.newest_ns(topic) or 0 for topic in self._core), default=0)
        found += self._go_on_without(self._behind(newest_ns))
        found += self._joined(self._policy.flush())
        return found + self._found(self._partners.flush())

    def close(self) -> None:
        """Report all messages still held as dropped."""
        for topic, name in enumerate(self._topics):
            self._attendance.hear(name, self._liveness.heard_ns(topic))
        self._policy.close()
        self._partners.close()

    def _note_silent(self, topics: Sequence[int]) -> None:
        for topic in topics:
            self._attendance.fall_silent(self._topics[topic], self._liveness.heard_ns(topic))
        self._late.difference_update(topics)

    def _insert(self, topic: int, item: Item) -> list[FoundSet]:
        stamp_ns = item.message.stamp_ns
        if topic in self._entering and not self._is_of_earlier_set(stamp_ns):
            self._entering.discard(topic)
            return self._wait() + self._insert(topic, item)
        if topic not in self._place or topic in self._entering:
            resolved = self._partners.add_item(topic, stamp_ns, item)
            return self._found(resolved) if resolved else []
        self._held[topic][item.number] = item
        sets = self._policy.add_item(self._place[topic], stamp_ns, item)
        return self._joined(sets) if sets else []

    def _is_worth_waiting_for(self, stamp_ns: int) -> bool:
        """Whether a message is so little behind the last set that half of the queue is enough to wait for its topic."""
        period_ns = self._liveness.period_ns(self._reference)
        return self._last_ns is None or stamp_ns > self._last_ns - self._queue_size * period_ns // 2

    def _is_of_earlier_set(self, stamp_ns: int) -> bool:
        """Whether a message of a topic that is about to be required belongs to a set that was found without it."""
        return self._last_ns is not None and stamp_ns <= self._last_ns + self._half_period_ns()

    def _half_period_ns(self) -> int:
        return (self._liveness.period_ns(self._reference) or self._slop_ns) // 2

    def _joined(self, sets: Sequence[tuple[Item, ...]]) -> list[FoundSet]:
        """Sets of the policy on their way to their partners."""
        found: list[FoundSet] = []
        place = self._place[self._reference]
        for items in sets:
            for topic, item in zip(self._core, items, strict=True):
                del self._held[topic][item.number]
            stamp_ns = items[place].message.stamp_ns
            self._last_ns = stamp_ns if self._last_ns is None else max(self._last_ns, stamp_ns)
            # The reference item comes first: the core may be another one when the set is resolved.
            ordered = (items[place], *items[:place], *items[place + 1 :])
            found += self._found(self._partners.add_reference(stamp_ns, ordered, self._core))
        return found

    def _found(self, resolved: Sequence[tuple[tuple[Item, ...], Mapping[int, Item]]]) -> list[FoundSet]:
        return [
            FoundSet(
                items[0].message,
                {self._index[item.message.channel.topic]: item.message for item in (*items, *partners.values())},
            )
            for items, partners in resolved
        ]

    def _choose_core(self, newcomer: RawMessage | None = None) -> list[FoundSet]:
        """Require the topics that are alive, and return the sets that become certain thereby.

        Sets before `newcomer`, by which a topic is alive again, are found without that topic.
        """
        there = self._there()
        core = tuple(t for t in self._required if t in there) or tuple(there[:1]) or self._core
        found: list[FoundSet] = []
        if core != self._core:
            if self._core:
                self._is_changing = True  # what the policy drops now may still be in a set
                sets = self._policy.flush()
                self._is_changing = False
                if newcomer is not None and self._index[newcomer.topic] in core:
                    place, until_ns = self._place[self._reference], newcomer.stamp_ns - self._half_period_ns()
                    sets = [items for items in sets if items[place].message.stamp_ns < until_ns]
                found += self._joined(sets)
            found += self._restart(core)
        return found + self._wait()

    def _there(self) -> list[int]:
        """Topics that can be waited for."""
        return [t for t in range(len(self._topics)) if self._liveness.is_alive(t) and t not in self._late]

    def _wait(self) -> list[FoundSet]:
        """Let the sets wait for all topics that may still join them, and return those that do not wait any more."""
        awaited = [topic for topic in self._there() if topic not in self._place or topic in self._entering]
        return self._found(self._partners.wait_for(awaited))

    def _restart(self, core: tuple[int, ...]) -> list[FoundSet]:
        """Make these topics the policy's, with the messages that are in no set yet."""
        items = [(item.number, topic, item) for topic, held in enumerate(self._held) for item in held.values()]
        new = set(core) - set(self._core)
        after_ns = None if self._last_ns is None else self._last_ns + self._half_period_ns()
        for topic in new:
            items += [(item.number, topic, item) for item in self._partners.take_after(topic, after_ns)]
        if after_ns is not None:
            self._entering |= new
        self._entering &= set(core)
        for held in self._held:
            held.clear()
        self._core, self._place = core, {topic: place for place, topic in enumerate(core)}
        self._reference = self._preferred if self._preferred in core else core[0]
        self._policy = ApproximateTime(
            len(core), queue_size=self._queue_size, max_interval_ns=self._max_interval_ns, on_drop=self._drop_item
        )
        found: list[FoundSet] = []
        for _, topic, item in sorted(items):
            found += self._insert(topic, item)
        return found

    def _behind(self, stamp_ns: int) -> set[int]:
        """Required topics with an overdue message, by their newest stamps before `stamp_ns`."""

        def is_late(topic: int) -> bool:
            newest_ns = self._liveness.newest_ns(topic)
            allowed_ns = max(self._slop_ns, round(MAX_PERIODS * self._liveness.period_ns(topic)))
            return newest_ns is None or newest_ns + allowed_ns < stamp_ns

        return set(filter(is_late, self._core))

    def _go_on_without(self, late: set[int]) -> list[FoundSet]:
        """Require these topics no longer, and return the sets that become certain thereby."""
        if not late:
            return []
        self._late |= late
        return self._choose_core()

    def _drop_item(self, item: Item, reason: str) -> None:
        if self._is_changing:
            return
        del self._held[self._index[item.message.topic]][item.number]
        self._on_drop(item.message, reason)

    def _drop_set(self, items: tuple[Item, ...], reason: str) -> None:
        for item in items:
            self._on_drop(item.message, reason)
