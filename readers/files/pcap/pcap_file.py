"""Network captures (pcap, pcapng) of Velodyne and Ouster lidars, as recordings of VelodynePackets and PacketMsgs.

Each lidar has a topic: `/velodyne_192_168_1_201/packets` is what 192.168.1.201 sent, with the port in the name if it
is not 2368, for instance `/velodyne_192_168_1_201_2369/packets`; an Ouster's is `/ouster_192_168_1_201/lidar_packets`.
The packets of an Ouster are those to port 7502, or to the port in the JSON beside the capture. The name depends on the
lidar alone, so one rig file fits all captures of a rig. Stamp and log time are the time of capture; a Velodyne's own
clock counts microseconds within the hour only. All other packets (GPS, other traffic) are counted by kind, on topics
that are not read.
"""

from array import array
from collections import Counter
from collections.abc import Collection, Iterator

import numpy as np

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.files.container import Container
from lidcam.readers.files.pcap.packets import (
    CUT_SHORT,
    FRAGMENTS,
    NOT_IPV4,
    NOT_UDP,
    UNKNOWN_LINK,
    Datagram,
    Reassembly,
    captured_packets,
    find_fragment,
    find_udp,
)
from lidcam.readers.ouster import packets as ouster
from lidcam.readers.ouster.description import DATA_PORT as OUSTER_PORT
from lidcam.readers.ouster.description import ports
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics
from lidcam.readers.velodyne.scan import PACKET, PACKET_BYTES, packet_channel, packet_message_data

DATA_PORT = 2368
POSITION_BYTES, OUSTER_IMU_BYTES = 512, 48

MAX_LIDARS = 64
"""Packets of more senders are not read."""

NO_TIME, OTHER_SIZE, POSITION, TOO_MANY = "no_time", "other_size", "position", "too_many_lidars"
OTHERS = {
    CUT_SHORT: "packets of which the capture kept too few bytes",
    FRAGMENTS: "fragments of IP packets of which others are missing",
    NOT_IPV4: "packets that are not IPv4",
    NOT_UDP: "IPv4 packets that are not UDP",
    NO_TIME: "packets without a time of capture",
    OTHER_SIZE: f"UDP packets of other sizes than a Velodyne's {PACKET_BYTES} bytes, and not to an Ouster's port",
    POSITION: "position packets (GPS), which are not used",
    TOO_MANY: f"packets of more than {MAX_LIDARS} lidars",
    UNKNOWN_LINK: "packets of another link type than Ethernet, Linux cooked, loopback and raw IP",
}
"""Packets that are not read, by the name of their topic below /other_traffic."""


class PcapFile(Container):
    """One open capture; see `RecordingFile`.

    It is read once as a whole when it is opened, and 30 bytes per packet are kept.
    """

    ros_version: RosVersion = "no ROS"

    def _describe(self) -> None:
        self._times, self._lidars = array("q"), array("H")
        self._positions, self._sizes, self._begins = array("q"), array("I"), array("Q")
        self._numbers: dict[tuple[bytes, int, bool], int] = {}
        self._ouster_ports = ports(self.path)
        others: Counter[str] = Counter()
        fragments = Reassembly()
        first_ns, last_ns = 2**63, -1
        for packet in captured_packets(self._stream, self._losses):
            time_ns = packet.time_ns
            if time_ns >= 0:
                first_ns, last_ns = min(first_ns, time_ns), max(last_ns, time_ns)
            found: Datagram | str | None = find_udp(packet.head, packet.position, packet.size, packet.link_type)
            if found == FRAGMENTS and (part := find_fragment(packet.head, packet.size, packet.link_type)):
                found = fragments.add(part, packet.position, packet.head)
            if found is not None:
                others.update(filter(None, [found if isinstance(found, str) else self._add(found, time_ns)]))
        others[FRAGMENTS] += fragments.close()
        others = +others
        self._channels = [_channel(*key) for key in self._numbers]
        counts = np.bincount(np.array(self._lidars, np.int64), minlength=len(self._channels)).tolist()
        self.topics = merge_topics(
            [TopicInfo(c.topic, c.msgtype, n, (c,)) for c, n in zip(self._channels, counts, strict=True) if n]
            + [TopicInfo(f"/other_traffic/{k}", "packet", n, (), OTHERS[k]) for k, n in others.items()]
        )
        self.message_count = len(self._times) + others.total()
        self.start_ns, self.end_ns = (first_ns, last_ns) if last_ns >= 0 else (0, 0)
        if not self.message_count and (losses := self.losses):
            raise EOFError(losses[0].reason)

    def _add(self, packet: Datagram, time_ns: int) -> str:
        """Index a packet; returns why it is not read, empty if it is."""
        size = sum(size for _, size in packet.pieces)
        is_ouster = size not in {PACKET_BYTES, OUSTER_IMU_BYTES} and packet.port in self._ouster_ports
        if size != PACKET_BYTES and not is_ouster:
            return POSITION if size == POSITION_BYTES else OTHER_SIZE
        if time_ns < 0:
            return NO_TIME
        key = packet.source, packet.port, is_ouster
        if key not in self._numbers and len(self._numbers) == MAX_LIDARS:
            return TOO_MANY
        self._lidars.append(self._numbers.setdefault(key, len(self._numbers)))
        self._times.append(time_ns)
        self._begins.append(len(self._positions))
        for position, piece in packet.pieces:
            self._positions.append(position)
            self._sizes.append(piece)
        return ""

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [number for number, channel in enumerate(self._channels) if topics is None or channel.topic in topics]
        times = np.array(self._times, np.int64)
        taken = np.isin(np.array(self._lidars), wanted)
        if start_ns is not None:
            taken &= times >= start_ns
        if stop_ns is not None:
            taken &= times < stop_ns
        rows = np.flatnonzero(taken)
        rows = rows[np.argsort(times[rows], kind="stable")]
        self._check_open()
        for part in np.array_split(rows, len(rows) // 4096 + 1):
            for row in part.tolist():
                self._check_open()
                yield self._message(row)

    def _message(self, row: int) -> RawMessage:
        begin = self._begins[row]
        end = self._begins[row + 1] if row + 1 < len(self._begins) else len(self._positions)
        data = b"".join(map(self._bytes, self._positions[begin:end], self._sizes[begin:end]))
        channel, time_ns = self._channels[self._lidars[row]], self._times[row]
        content = packet_message_data(time_ns, data) if channel.msgtype == PACKET else ouster.packet_message_data(data)
        return RawMessage(time_ns, time_ns, (self._source.index, self._positions[begin]), content, channel)

    def _bytes(self, position: int, size: int) -> bytes:
        self._stream.seek(position)
        return self._stream.read(size)


def _channel(source: bytes, port: int, is_ouster: bool) -> Channel:
    name = "_".join(map(str, [*source] if port == (OUSTER_PORT if is_ouster else DATA_PORT) else [*source, port]))
    return (
        ouster.packet_channel(f"/ouster_{name}/lidar_packets")
        if is_ouster
        else packet_channel(f"/velodyne_{name}/packets")
    )
