"""Gathers VelodynePackets into sweeps: one VelodyneScan per turn of the head.

A sweep ends before the first packet that begins beyond azimuth zero, so the packet in which the head passes zero
belongs to the sweep before. The packets before the first cut and after the last one are sweeps too, only shorter. In a
gap of the sensor's own clock, of lost packets or beyond a limited field of view, the head turns on at its speed before.
A sweep also ends where that is unknown or the clock jumps back, after a pause in the recording, and at a number of
packets that no turn has. A late packet stays in the sweep that it arrived in.

A sweep has the stamp of its first packet.
"""

import struct
from collections.abc import Sequence

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.sweeps import Sweep
from lidcam.readers.velodyne.scan import packet_data, scan_channel, scan_data

MIN_HIDDEN_TURN_US = 50_000
"""A turn at 1200 a minute, a Velodyne's maximum: azimuths do not show how often the head turned in a gap."""

MAX_OVERTAKEN = 2_000
"""Maximum distance, in hundredths of a degree, of a late packet behind the one that arrived before it."""

MAX_PACKETS = 4096
"""Packets per sweep: a VLS-128 at 300 turns a minute sends 2500 in dual return mode."""

UPPER_BLOCK = 0xEEFF
TURN = 36_000
HOUR_US = 3_600_000_000

_FIRST_BLOCK_AND_CLOCK = struct.Struct("<8x HH 1196x I")
"""Fields of a stamped packet: flag and azimuth of the first block, and the sensor's microseconds in the hour."""


class VelodyneSweep(Sweep):
    """The packets of one topic since the last cut; see `Sweep`."""

    def __init__(self, topic: str) -> None:
        super().__init__(scan_channel(topic))
        self._azimuth = 0  # of the last packet
        self._turned = 0  # the same, counting full turns
        self._speed = 0.0  # hundredths of a degree per microsecond; 0 if unknown
        self._clock_us: int | None = None
        self._cut_at = 0

    def add_packet(self, message: RawMessage) -> RawMessage | None:
        """See `Sweep`."""
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

    def _message_of(self, packets: Sequence[bytes | memoryview]) -> tuple[int, bytes] | None:
        if not packets:
            return None
        sec, nanosec = struct.unpack_from("<II", packets[0])
        return sec * 10**9 + nanosec, scan_data(packets)

    def pause(self) -> RawMessage | None:
        """End the sweep and return it; the next packet begins a new one at any azimuth."""
        self._clock_us = None
        return self.close()

    def _begins_another(self, packet: bytes | memoryview) -> bool:
        full = len(self._packets) >= MAX_PACKETS
        flag, azimuth, clock_us = _FIRST_BLOCK_AND_CLOCK.unpack_from(packet)
        if flag != UPPER_BLOCK or azimuth >= TURN:  # not a valid azimuth
            return full
        is_unknown = self._clock_us is None
        if self._clock_us is not None:
            since_us = (clock_us - self._clock_us + HOUR_US // 2) % HOUR_US - HOUR_US // 2
            turn = (azimuth - self._azimuth + MAX_OVERTAKEN) % TURN - MAX_OVERTAKEN
            if abs(since_us) >= MIN_HIDDEN_TURN_US:
                is_unknown = since_us < 0 or not self._speed
                turn += TURN * round((self._speed * since_us - turn) / TURN)
            elif since_us > 0 and turn > 0:
                self._speed = turn / since_us
            self._turned += turn
        begins = is_unknown and self._clock_us is not None
        if is_unknown:
            self._turned, self._cut_at = azimuth, TURN
        self._azimuth, self._clock_us = azimuth, clock_us
        if self._turned < self._cut_at:
            return begins or full
        self._cut_at = (self._turned // TURN + 1) * TURN
        return True
