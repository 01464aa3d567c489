"""Correction of stamps: offsets are removed, impossible stamps dropped, and clocks that are set meanwhile are followed.

A message is judged by the stamp before it on its topic, and by its delay (log time minus stamp). One that goes back by
more than a second, or is that much further ahead of the recorder than those before it, is held until the next message
of its topic: if that one agrees with it, the clock was set, else it is an outlier. A message that is only recorded late
is neither. Where the clocks of all topics are set alike, or log times jump back, a new part begins. The stamps of a
topic whose clock alone is set are moved on with those of the others. A first stamp of 0 is the beginning of simulated
time if the next one agrees with it, else the message came before its clock was set. A message whose stamp or log time
no output could hold (before 1970, after January 2038) is bad in any case.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Literal, NamedTuple

from lidcam.pipeline.core.messages import Drop, RawMessage, time_fault

JUMP_NS = 1_000_000_000
"""Minimum step of a jump, nanoseconds; smaller ones are disorder or changes of the recording delay."""

MAX_FIRST_DELAY_NS = 10_000_000_000
"""Maximum recording delay of a topic's first message that is accepted at once, nanoseconds."""

ALIVE_NS = 2_000_000_000
"""Maximum time since its last message of a topic whose clock may be set with those of others, nanoseconds."""

DELAYS = 5
"""Number of delays kept per topic; the minimum is its usual one."""

MIN_PACE = 0.02
"""Minimum step of a stamp, as a share of the time until its message was recorded; slow simulations have 0.1."""

NO_TIME = "its stamp cannot be a time"
NO_LOG_TIME = "its log time cannot be a time"
ZERO = "its stamp is 0"
OUTLIER = "its stamp is far from those around it"


class TimeJump(NamedTuple):
    """Time jumps."""

    # `stamps` of all topics, `log times` of the recorder, or stamps of one topic alone: `moved` to those of the others,
    # or `set` right, with which they agree from there on
    kind: Literal["stamps", "log times", "moved", "set"]
    at_ns: int  # Log time of the first message after it, or, where log times jump, of the last one before it
    by_ns: int  # How far back; negative: ahead
    topic: str = ""  # The topic whose stamps jump alone


@dataclass(slots=True)
class _Clock:
    """State of one topic."""

    offset_ns: int  # Offset that is taken off its stamps
    is_stamped: bool  # Whether its messages have stamps of a clock that may be set
    step_ns: int = 0  # How far its clock alone has been set ahead; taken off its stamps, too
    last_ns: int | None = None  # Corrected stamp of its last good message; None before the first
    log_time_ns: int | None = None  # Log time of its last message; None before the first
    delays_ns: deque[int] = field(default_factory=lambda: deque(maxlen=DELAYS))  # Delays of its last good messages
    held: RawMessage | None = None  # A message that the next one decides on
    is_unstamped: bool = False  # Whether its stamps are all 0
    steps: int = 0  # Number of steps from one good message to the next
    stalled: int = 0  # Number of those in which its stamps hardly advanced

    def is_sound(self, message: RawMessage) -> bool:
        """Whether a message neither goes back nor is further ahead of the recorder than those before it."""
        if self.last_ns is None:
            return True
        is_back = message.stamp_ns < self.last_ns - JUMP_NS
        return not is_back and _delay_ns(message) >= min(self.delays_ns) - JUMP_NS

    def may_be_set(self, log_time_ns: int) -> bool:
        """Whether its clock may be set about a log time: it has one, and messages of it come."""
        heard_ns = self.log_time_ns
        return self.is_stamped and bool(self.delays_ns) and heard_ns is not None and log_time_ns - heard_ns <= ALIVE_NS

    @property
    def all_steps_ns(self) -> int:
        """How far its clock has been set ahead, if the message that is held tells."""
        return self.step_ns + (min(self.delays_ns) - _delay_ns(self.held) if self.held else 0)

    def take(self, message: RawMessage) -> None:
        """Take note of a good message."""
        delay_ns = _delay_ns(message)
        if self.last_ns is not None and self.delays_ns:
            step_ns = message.stamp_ns - self.last_ns
            self.steps += 1
            self.stalled += abs(step_ns) < MIN_PACE * (step_ns + delay_ns - self.delays_ns[-1])
        self.last_ns = message.stamp_ns
        self.delays_ns.append(delay_ns)


class Clocks:
    """The clocks of the sensors over one pass through a recording.

    Args:
        offsets_ns: Offsets that are taken off the stamps, by topic; other topics have no stamps of a clock.
        on_drop: Called for each message whose stamp does not fit those around it.
        on_start: Called in its place for the first message of a topic, if its stamp is 0 and those after it are not.
        on_bad: Called for each message whose stamp or log time cannot be a time.

    Attributes:
        jumps: Where time jumped, so far.
        unstamped: Topics whose stamps are all 0, so far: log times are used instead.
    """

    def __init__(
        self,
        offsets_ns: Mapping[str, int],
        *,
        on_drop: Callable[[Drop], None],
        on_bad: Callable[[Drop], None],
        on_start: Callable[[Drop], None] | None = None,
    ) -> None:
        self._offsets_ns = offsets_ns
        self._on_drop = on_drop
        self._on_start = on_start or on_drop
        self._on_bad = on_bad
        self._clocks: dict[str, _Clock] = {}
        self._part = 0
        self.jumps: list[TimeJump] = []
        self.unstamped: dict[str, None] = {}

    @property
    def stalled(self) -> dict[str, tuple[int, int]]:
        """By topic: number of steps in which its stamps hardly advanced though its messages did, and of all steps."""
        return {topic: (clock.stalled, clock.steps) for topic, clock in self._clocks.items() if clock.stalled}

    def parts(self, messages: Iterable[RawMessage]) -> Iterator[Iterator[RawMessage]]:
        """The messages with corrected stamps, split where time jumps; each part is to be read before the next.

        Args:
            messages: In the order in which they were recorded.
        """
        numbered = (one for one in self._numbered(messages) if self._is_time(one[1]))
        for _, part in groupby(numbered, key=lambda numbered: numbered[0]):
            yield (message for _, message in part)

    def _numbered(self, messages: Iterable[RawMessage]) -> Iterator[tuple[int, RawMessage]]:
        """Part and message."""
        for message in messages:
            topic = message.channel.topic
            clock = self._clocks.get(topic)
            if clock is None:
                clock = self._clocks[topic] = _Clock(self._offsets_ns.get(topic, 0), topic in self._offsets_ns)
            if not self._is_time(message):
                continue
            if clock.log_time_ns is not None and message.log_time_ns < clock.log_time_ns - JUMP_NS:
                yield from self._released()
                self._begin_part(TimeJump("log times", clock.log_time_ns, clock.log_time_ns - message.log_time_ns))
            clock.log_time_ns = message.log_time_ns
            if _lacks_stamp(message, clock.offset_ns):
                found = self._unstamped(clock, message)
            else:
                found = self._stamped(clock, _moved(message, clock.offset_ns + clock.step_ns))
            for good in found:
                yield self._part, good
        yield from self._released()

    def _is_time(self, message: RawMessage) -> bool:
        """Whether the stamp and the log time of a message can be times; if not, it is bad."""
        times = ("log time", NO_LOG_TIME, message.log_time_ns), ("stamp", NO_TIME, message.stamp_ns)
        for what, reason, time_ns in times:
            if fault := time_fault(time_ns):
                self._on_bad(Drop(message.topic, message.stamp_ns, reason, f"{message.topic}: {what} {fault}"))
                return False
        return True

    def _begin_part(self, jump: TimeJump) -> None:
        """Start a part for all topics."""
        self._part += 1
        self.jumps.append(jump)
        for clock in self._clocks.values():
            clock.log_time_ns, clock.last_ns = None, None

    def _unstamped(self, clock: _Clock, message: RawMessage) -> list[RawMessage]:
        """A message whose stamp is 0: its driver never sets stamps, or it is a fault."""
        held = clock.held
        if clock.is_unstamped:
            return [_at_log_time(message, clock.offset_ns)]
        if clock.delays_ns:
            self._drop(message, ZERO)
            return []
        clock.held = message
        if held is None:
            return []
        if held.stamp_ns != 0:
            self._drop(held, OUTLIER)
            return []
        clock.held, clock.is_unstamped = None, True
        self.unstamped[message.topic] = None
        return [_at_log_time(held, clock.offset_ns), _at_log_time(message, clock.offset_ns)]

    def _stamped(self, clock: _Clock, message: RawMessage) -> list[RawMessage]:
        held, clock.held = clock.held, None
        is_zero = held is not None and held.stamp_ns in {0, -clock.offset_ns}
        if held is not None and is_zero and ((held.stamp_ns == 0 and clock.offset_ns) or not _agree(held, message)):
            self._on_start(_far_off(held, ZERO))
            held = None
        clock.is_unstamped = False
        if clock.last_ns is None:
            return self._first(clock, held, message)
        if clock.is_sound(message):
            return self._sound(clock, clock.last_ns, held, message)
        if held is None or not _agree(held, message):
            if held is not None:
                self._drop(held, OUTLIER)
            clock.held = message
            return []
        return self._good(clock, *self._step(clock, held, message))

    def _step(self, clock: _Clock, *after: RawMessage) -> list[RawMessage]:
        """Messages that agree with one another, not with those before them: the clock of their topic was set."""
        before_ns, after_ns = min(clock.delays_ns), min(map(_delay_ns, after))
        clock.delays_ns.clear()
        if abs(before_ns - max(map(_delay_ns, after))) <= JUMP_NS:
            return [*after]
        topic, at_ns, step_ns = after[0].topic, after[0].log_time_ns, before_ns - after_ns
        all_ns = clock.step_ns + step_ns
        all_ns = all_ns if abs(all_ns) > JUMP_NS else 0  # it is as it was at first
        others = [one for one in self._clocks.values() if one is not clock and one.may_be_set(at_ns)]
        if all_ns and all(abs(one.all_steps_ns - all_ns) <= JUMP_NS for one in others):
            while self.jumps and self.jumps[-1].kind == "moved":  # those of others were not alone, as it turns out
                self.jumps.pop()
            self._begin_part(TimeJump("stamps", at_ns, -all_ns))
            after = tuple(_moved(one, -clock.step_ns) for one in after)
            for one in self._clocks.values():
                one.held = _moved(one.held, -one.step_ns) if one.held else None
                one.step_ns = 0
                one.delays_ns.clear()
            return [*after]
        apart_ns = [[abs(one.delays_ns[-1] - delay_ns) for one in others] for delay_ns in (before_ns, after_ns)]
        before, now = (sum(ns <= JUMP_NS for ns in each) for each in apart_ns)
        if before < now:
            self.jumps.append(TimeJump("set", at_ns, -step_ns, topic))
            return [*after]
        self.jumps.append(TimeJump("moved", at_ns, -step_ns, topic))
        back_ns, clock.step_ns = all_ns - clock.step_ns, all_ns
        return [_moved(one, back_ns) for one in after]

    def _first(self, clock: _Clock, held: RawMessage | None, message: RawMessage) -> list[RawMessage]:
        """A message of a topic without a good one before it in this part."""
        if held is not None and _agree(held, message):
            return self._good(clock, held, message)
        if held is not None:
            self._drop(held, OUTLIER)
        delay_ns = _delay_ns(message)
        known_ns = [clock.delays_ns[-1] for clock in self._clocks.values() if clock.delays_ns]

        def is_likely(delay_ns: int) -> bool:
            is_near = any(abs(delay_ns - other_ns) <= JUMP_NS for other_ns in known_ns)
            return is_near or -JUMP_NS <= delay_ns <= MAX_FIRST_DELAY_NS

        if not is_likely(delay_ns) and is_likely(delay_ns - clock.offset_ns):  # its clock has been set since
            message, clock.offset_ns = _moved(message, -clock.offset_ns), 0
        elif not is_likely(delay_ns):
            return self._unlikely(clock, message)
        return self._good(clock, message)

    def _unlikely(self, clock: _Clock, message: RawMessage) -> list[RawMessage]:
        """A first message with another delay than all others: good if it is that of another first one."""
        confirmed: list[RawMessage] = []
        for other in self._clocks.values():
            if other.held is not None and other.last_ns is None and other.held.stamp_ns and _agree(other.held, message):
                confirmed += self._good(other, other.held)
                other.held = None
        if confirmed:
            return [*confirmed, *self._good(clock, message)]
        clock.held = message
        return []

    def _sound(self, clock: _Clock, last_ns: int, held: RawMessage | None, message: RawMessage) -> list[RawMessage]:
        """A message that continues those before it; it decides on the one that was held."""
        if held is None:
            return self._good(clock, message)
        if last_ns <= held.stamp_ns <= message.stamp_ns:
            return self._good(clock, held, message)
        self._drop(held, OUTLIER)
        return self._good(clock, message)

    def _good(self, clock: _Clock, *messages: RawMessage) -> list[RawMessage]:
        for message in messages:
            clock.take(message)
        return [*messages]

    def _released(self) -> Iterator[tuple[int, RawMessage]]:
        """At the end of a part: what is held and no later message decides on."""
        for clock in self._clocks.values():
            held, clock.held = clock.held, None
            if held is None:
                continue
            if _lacks_stamp(held, clock.offset_ns):
                self.unstamped[held.topic] = None
                yield self._part, _at_log_time(held, clock.offset_ns)
            elif clock.is_sound(held):
                clock.take(held)
                yield self._part, held
            else:
                self._drop(held, OUTLIER)

    def _drop(self, message: RawMessage, reason: str) -> None:
        self._on_drop(_far_off(message, reason))


def _far_off(message: RawMessage, reason: str) -> Drop:
    apart_s = (message.stamp_ns - message.log_time_ns) / 1e9
    side = "after" if apart_s > 0 else "before"
    return Drop(message.topic, message.stamp_ns, reason, f"{abs(apart_s):.1f} s {side} its log time")


def _lacks_stamp(message: RawMessage, offset_ns: int) -> bool:
    """Whether a stamp of 0 means none: simulated time begins at 0, and so does a clock that was not set."""
    return message.stamp_ns == 0 and message.log_time_ns > JUMP_NS and abs(offset_ns) <= MAX_FIRST_DELAY_NS


def _at_log_time(message: RawMessage, offset_ns: int) -> RawMessage:
    return message._replace(stamp_ns=message.log_time_ns - offset_ns)


def _moved(message: RawMessage, back_ns: int) -> RawMessage:
    return message._replace(stamp_ns=message.stamp_ns - back_ns)


def _delay_ns(message: RawMessage) -> int:
    return message.log_time_ns - message.stamp_ns


def _agree(first: RawMessage, second: RawMessage) -> bool:
    """Whether two messages' clocks are the same: equal delays, up to a jump."""
    return abs(_delay_ns(second) - _delay_ns(first)) <= JUMP_NS
