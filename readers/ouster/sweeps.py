"""Gathers an Ouster's packets into sweeps, by the numbers of turns that they have.

A sweep ends before the first packet of a later turn. A packet of an earlier one came too late, and is counted.
"""

from collections.abc import Sequence
from contextlib import suppress

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.ouster.packets import packet_data, sweep_channel, sweep_data
from lidcam.readers.ouster.sensor import sensor_of
from lidcam.readers.sweeps import Sweep

MAX_PACKETS = 4096
"""Packets per sweep: 4096 columns, one in each."""


class OusterSweep(Sweep):
    """The packets of one topic and turn; see `Sweep`."""

    def __init__(self, topic: str, frame_id: str, metadata: str) -> None:
        super().__init__(sweep_channel(topic))
        self._frame_id, self._metadata, self._sensor = frame_id, metadata, sensor_of(metadata)
        self._received_ns: list[int] = []
        self._number = 0

    def add_packet(self, message: RawMessage) -> RawMessage | None:
        """See `Sweep`."""
        done = None
        try:
            packet = packet_data(message, self._sensor.packet_bytes)
        except MessageError as err:
            self._defects.append(str(err))
        else:
            number = self._sensor.frame_number(packet)
            if self._packets and self._sensor.is_later(number, self._number):
                done = self.close()
            if self._packets and number != self._number:
                self._defects.append(f"{message.topic}: a packet of turn {number} within turn {self._number}")
            else:
                self._number = number
                self._packets.append(packet)
                self._received_ns.append(message.log_time_ns)
        self.end = message.log_time_ns, message.order
        return done or (self.close() if len(self._packets) + len(self._defects) >= MAX_PACKETS else None)

    def _message_of(self, packets: Sequence[bytes | memoryview]) -> tuple[int, bytes] | None:
        received_ns, self._received_ns = self._received_ns, []
        for packet, packet_ns in zip(packets, received_ns, strict=True):
            with suppress(MessageError):  # of a part of the turn that the lidar does not measure, or damaged
                stamp_ns, begin_ns = self._sensor.times_ns(packet, packet_ns)
                return stamp_ns, sweep_data(stamp_ns, begin_ns, self._frame_id, self._metadata, packets)
        return None
