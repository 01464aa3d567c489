"""Gathers an Ouster's packets into sweeps, by the numbers of turns that they have.

A sweep ends before the first packet of a later turn. A packet of an earlier one came too late, and is counted.
"""

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.ouster.packets import packet_data, sweep_channel, sweep_data
from lidcam.readers.ouster.sensor import sensor_of

MAX_PACKETS = 4096
"""Packets per sweep: 4096 columns, one in each."""


class OusterSweep:
    """The packets of one topic and turn; see `Sweep` in `readers.streams.sweeps`."""

    def __init__(self, topic: str, frame_id: str, metadata: str) -> None:
        self._channel, self._frame_id, self._metadata = sweep_channel(topic), frame_id, metadata
        self._sensor = sensor_of(metadata)
        self._packets: list[bytes] = []
        self._defects: list[str] = []
        self._received_ns: list[int] = []
        self._number = 0
        self.end: tuple[int, tuple[int, ...]] = (0, ())

    @property
    def is_open(self) -> bool:
        """Whether it has packets."""
        return bool(self._packets or self._defects)

    def add_packet(self, message: RawMessage) -> RawMessage | None:
        """Add a packet; returns the sweep before it if the packet begins a new one."""
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

    def close(self) -> RawMessage | None:
        """End the sweep and return it; None if it is empty."""
        if not self.is_open:
            return None
        packets, received_ns, defects = self._packets, self._received_ns, tuple(self._defects)
        self._packets, self._received_ns, self._defects = [], [], []
        log_time_ns, order = self.end
        for packet, packet_ns in zip(packets, received_ns, strict=True):
            try:
                stamp_ns, begin_ns = self._sensor.times_ns(packet, packet_ns)
            except MessageError:  # of a part of the turn that the lidar does not measure, or damaged
                continue
            data = sweep_data(stamp_ns, begin_ns, self._frame_id, self._metadata, packets)
            return RawMessage(stamp_ns, log_time_ns, order, data, self._channel, defects=defects)
        problem = "a turn without a valid column"
        if defects:
            problem = f"none of {len(packets) + len(defects)} packets can be used; the first: {defects[0]}"
        return RawMessage(log_time_ns, log_time_ns, order, b"", self._channel, problem)

    pause = close
