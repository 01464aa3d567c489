"""VelodynePackets to sweeps: each turn of the head becomes one VelodyneScan, for which all the rest of lidcam is made.

A sweep is cut before the first packet that begins beyond azimuth zero, so the packet in which the head passes zero ends
the sweep that it began in. What was recorded before the first cut and after the last one are sweeps, too, only shorter.
A sweep also ends where the sensor's own clock shows that packets are missing for a time in which the head may have
turned once, where nothing was recorded for a while, and at a number of packets that no turn has. A packet that was
overtaken by others on its way stays in the sweep that it arrived in.

A sweep has the stamp of its first packet, and the log time and order of its last one, with which it was complete. So
messages of other topics wait until it is known whether a sweep that is open ends before them.
"""

import heapq
import struct
from collections.abc import Container, Iterable, Iterator

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage
from readers.velodyne.packet import packet_data, scan_channel, scan_data

__all__ = ["PAUSE_NS", "gather_sweeps"]

PAUSE_NS = 500_000_000
"""Log time without a packet after which a sweep is complete; no sweep takes as long (300 turns a minute: 0.2 s)."""

HIDDEN_TURN_US = 50_000
"""A turn at 1200 a minute, the most that a Velodyne makes: azimuths do not tell how often the head turned meanwhile."""

OVERTAKEN = 2_000
"""Hundredths of a degree by which a packet may begin before the one that came in before it."""

MAX_PACKETS = 4096
"""Packets of a sweep at most: a VLS-128 at 300 turns a minute sends 2500 in dual return mode."""

UPPER_BLOCK = 0xEEFF
TURN = 36_000
HOUR_US = 3_600_000_000

_FIRST_BLOCK_AND_CLOCK = struct.Struct("<8x HH 1196x I")
"""Of a stamped packet: flag and azimuth of the first block, the sensor's microseconds in the hour."""


def gather_sweeps(
    messages: Iterable[RawMessage], packets: Container[Channel], *, start_ns: int | None, stop_ns: int | None
) -> Iterator[RawMessage]:
    """Messages with those of the channels `packets` gathered into sweeps, in the order of (log time, order).

    A packet that cannot be used is named in `RawMessage.defects` of its sweep.

    Args:
        messages: In the order of (log time, order), from `PAUSE_NS` before `start_ns` to `PAUSE_NS` behind `stop_ns`:
            the first and the last sweep are then the same as if all was read.
        packets: Channels of VelodynePackets.
        start_ns: Only sweeps and messages of this log time or later.
        stop_ns: Only sweeps and messages before this log time.
    """
    first_ns = -1 if start_ns is None else start_ns
    waiting: list[tuple[int, tuple[int, ...], RawMessage]] = []
    sweeps: dict[str, _Sweep] = {}

    def put(message: RawMessage | None) -> None:
        if message is not None and message.log_time_ns >= first_ns:
            heapq.heappush(waiting, (message.log_time_ns, message.order, message))

    for message in messages:
        now_ns = message.log_time_ns
        for sweep in sweeps.values():
            if now_ns - sweep.end[0] >= PAUSE_NS:
                put(sweep.pause())
        if message.channel in packets:
            sweep = sweeps.get(message.topic) or sweeps.setdefault(message.topic, _Sweep(message.topic))
            put(sweep.add(message))
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


class _Sweep:
    """The packets of one topic since the last cut.

    Attributes:
        end: Log time and order of the last packet.
    """

    def __init__(self, topic: str) -> None:
        self._channel = scan_channel(topic)
        self._packets: list[bytes | memoryview] = []
        self._defects: list[str] = []
        self._azimuth = 0  # where the last packet began
        self._turned = 0  # the same, with all turns since the azimuths tell them
        self._clock_us: int | None = None
        self._cut_at = 0
        self.end: tuple[int, tuple[int, ...]] = (0, ())

    @property
    def is_open(self) -> bool:
        """Whether it has packets."""
        return bool(self._packets or self._defects)

    def add(self, message: RawMessage) -> RawMessage | None:
        """Take in a packet; returns the sweep before it, if it begins another one."""
        done = None
        try:
            packet = packet_data(message)
        except MessageError as err:
            if len(self._defects) >= MAX_PACKETS:
                done = self.close()
            self._defects.append(str(err))
        else:
            if self._begins_another(packet):
                done = self.close()
            self._packets.append(packet)
        self.end = message.log_time_ns, message.order
        return done

    def close(self) -> RawMessage | None:
        """The sweep, which is empty after that; None if it is."""
        if not self.is_open:
            return None
        packets, defects, (log_time_ns, order) = self._packets, tuple(self._defects), self.end
        self._packets, self._defects = [], []
        if not packets:
            return RawMessage(log_time_ns, log_time_ns, order, b"", self._channel, defects[0])
        sec, nanosec = struct.unpack_from("<II", packets[0])
        data = scan_data(packets)
        return RawMessage(sec * 10**9 + nanosec, log_time_ns, order, data, self._channel, defects=defects)

    def pause(self) -> RawMessage | None:
        """As `close`; the next packet begins anew, wherever the head is then."""
        self._clock_us = None
        return self.close()

    def _begins_another(self, packet: bytes | memoryview) -> bool:
        full = len(self._packets) >= MAX_PACKETS
        flag, azimuth, clock_us = _FIRST_BLOCK_AND_CLOCK.unpack_from(packet)
        if flag != UPPER_BLOCK or azimuth >= TURN:  # says nothing of the head
            return full
        if self._clock_us is None:
            missing = False
        else:
            missing = abs((clock_us - self._clock_us + HOUR_US // 2) % HOUR_US - HOUR_US // 2) >= HIDDEN_TURN_US
        if missing or self._clock_us is None:
            self._turned, self._cut_at = azimuth, TURN
        else:
            self._turned += (azimuth - self._azimuth + OVERTAKEN) % TURN - OVERTAKEN
        self._azimuth, self._clock_us = azimuth, clock_us
        if self._turned < self._cut_at:
            return missing or full
        self._cut_at = (self._turned // TURN + 1) * TURN
        return True
