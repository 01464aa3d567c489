"""Gathers single packets of lidars into sweeps: one message per turn of the head.

A sweep has the log time and order of its last packet. Messages of other topics therefore wait until it is known whether
an open sweep ends before them.
"""

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from lidcam.pipeline.core.messages import Channel, RawMessage

PAUSE_NS = 500_000_000
"""Log time without a packet after which a sweep is complete; no sweep takes as long (300 turns a minute: 0.2 s)."""


class Sweep(ABC):
    """The packets of one topic since the last cut.

    Attributes:
        end: Log time and order of the last packet.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._packets: list[bytes | memoryview] = []
        self._defects: list[str] = []
        self.end: tuple[int, tuple[int, ...]] = (0, ())

    @property
    def is_open(self) -> bool:
        """Whether it has packets."""
        return bool(self._packets or self._defects)

    @abstractmethod
    def add_packet(self, message: RawMessage) -> RawMessage | None:
        """Add a packet; returns the sweep before it if the packet begins a new one."""

    @abstractmethod
    def _message_of(self, packets: Sequence[bytes | memoryview]) -> tuple[int, bytes] | None:
        """Stamp and data of a message with some packets; None if they cannot be used."""

    def close(self) -> RawMessage | None:
        """End the sweep and return it; None if it is empty."""
        if not self.is_open:
            return None
        packets, defects, (log_time_ns, order) = self._packets, tuple(self._defects), self.end
        self._packets, self._defects = [], []
        if found := self._message_of(packets):
            return RawMessage(found[0], log_time_ns, order, found[1], self._channel, defects=defects)
        problem = "a turn without a valid column"
        if defects:
            problem = f"none of {len(packets) + len(defects)} packets can be used; the first: {defects[0]}"
        return RawMessage(log_time_ns, log_time_ns, order, b"", self._channel, problem)

    def pause(self) -> RawMessage | None:
        """End the sweep, before a gap in the packets, and return it."""
        return self.close()


def gather_sweeps(
    messages: Iterable[RawMessage],
    packets: Mapping[Channel, Callable[[str], Sweep]],
    *,
    start_ns: int | None,
    stop_ns: int | None,
) -> Iterator[RawMessage]:
    """Messages with those of the channels `packets` gathered into sweeps, in the order of (log time, order).

    `packets` has what makes the sweeps of a topic. The messages begin `PAUSE_NS` before `start_ns` and end `PAUSE_NS`
    after `stop_ns`, so that the first and the last sweep are the same as if everything were read.

    A packet that cannot be used is reported in `RawMessage.defects` of its sweep.
    """
    first_ns = -1 if start_ns is None else start_ns
    waiting: list[tuple[int, tuple[int, ...], RawMessage]] = []
    sweeps: dict[str, Sweep] = {}

    def put(message: RawMessage | None) -> None:
        if message is not None and message.log_time_ns >= first_ns:
            heapq.heappush(waiting, (message.log_time_ns, message.order, message))

    for message in messages:
        now_ns = message.log_time_ns
        for sweep in sweeps.values():
            if now_ns - sweep.end[0] >= PAUSE_NS:
                put(sweep.pause())
        if message.channel in packets:
            if message.topic not in sweeps:
                sweeps[message.topic] = packets[message.channel](message.topic)
            put(sweeps[message.topic].add_packet(message))
        else:
            put(message)
        known = min((sweep.end for sweep in sweeps.values() if sweep.is_open), default=(now_ns, message.order))
        while waiting and waiting[0][:2] <= known:
            if stop_ns is not None and waiting[0][0] >= stop_ns:
                return
            yield heapq.heappop(waiting)[2]
        if stop_ns is not None and known[0] >= stop_ns:
            return
    for sweep in sweeps.values():
        put(sweep.close())
    while waiting and (stop_ns is None or waiting[0][0] < stop_ns):
        yield heapq.heappop(waiting)[2]
