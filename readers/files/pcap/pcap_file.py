"""Network captures (pcap, pcapng) of Velodyne lidars, as recordings of VelodynePackets.

Each lidar has a topic: `/velodyne_192_168_1_201/packets` is what 192.168.1.201 sent, with the port in the name if it is
not 2368, for instance `/velodyne_192_168_1_201_2369/packets`. The name depends on the lidar alone, so one rig file fits
all captures of a rig. Stamp and log time are the time of capture; the packets' own clock counts microseconds within the
hour only. All other packets (GPS, other traffic) are counted by kind, on topics that are not read.
"""

from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.files.container import Container
from lidcam.readers.files.pcap.packets import captured_packets
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics
from lidcam.readers.velodyne.scan import PACKET_BYTES, packet_channel, packet_message_data

ETHERNET, RAW_IP, SLL, SLL2 = 1, frozenset({12, 14, 101, 228, 229}), 113, 276
NULL, LOOP = 0, 108
VLAN_TAGS = frozenset({0x8100, 0x88A8, 0x9100})
IPV4 = 0x0800
UDP = 17

# Kinds of packets that are not UDP.
CUT_SHORT = "cut_short"
FRAGMENTS = "fragments"
NOT_IPV4 = "not_ipv4"
NOT_UDP = "not_udp"
UNKNOWN_LINK = "unknown_link"


class Udp(NamedTuple):
    """A UDP packet."""

    source: bytes  # Address of the sender, 4 bytes
    port: int  # Destination port
    data_at: int  # Offset of its data in the captured packet
    size: int  # Bytes of its data


def find_udp(head: bytes, captured: int, link_type: int) -> Udp | str:
    """The UDP packet in a packet of `captured` bytes, whose first ones are `head`; or one of the kinds above."""
    try:
        at = _ipv4_begin(head, link_type)
        return at if isinstance(at, str) else _udp(head, at, captured)
    except IndexError:
        return CUT_SHORT


def _u16(head: bytes, at: int) -> int:
    return head[at] << 8 | head[at + 1]


def _ipv4_begin(head: bytes, link_type: int) -> int | str:
    """Start of the IPv4 packet, or the kind of another packet."""
    if link_type == ETHERNET:
        at = 12
        while (kind := _u16(head, at)) in VLAN_TAGS:
            at += 4
        at += 2
    elif link_type == SLL:
        kind, at = _u16(head, 14), 16
    elif link_type == SLL2:
        kind, at = _u16(head, 0), 20
    elif link_type in RAW_IP or link_type in {NULL, LOOP}:
        at = 0 if link_type in RAW_IP else 4  # skips the address family, whose numbers differ between systems
        kind = IPV4 if head[at] >> 4 == 4 else 0
    else:
        return UNKNOWN_LINK
    return at if kind == IPV4 else NOT_IPV4


def _udp(head: bytes, at: int, captured: int) -> Udp | str:
    """The UDP packet in the IPv4 packet that begins at `at`."""
    if _u16(head, at + 6) & 0x3FFF:  # more fragments, or not the first one
        return FRAGMENTS
    if head[at + 9] != UDP:
        return NOT_UDP
    source = head[at + 12 : at + 16]
    at += 4 * (head[at] & 0x0F)
    port, size = _u16(head, at + 2), _u16(head, at + 4) - 8
    if size < 0 or at + 8 + size > captured:
        return CUT_SHORT
    return Udp(source, port, at + 8, size)


DATA_PORT = 2368
POSITION_BYTES = 554

MAX_LIDARS = 64
"""Packets of more senders are not read."""

NO_TIME, OTHER_SIZE, POSITION, TOO_MANY = "no_time", "other_size", "position", "too_many_lidars"
OTHERS = {
    CUT_SHORT: "packets of which the capture kept too few bytes",
    FRAGMENTS: "fragments of IP packets, which no Velodyne sends",
    NOT_IPV4: "packets that are not IPv4",
    NOT_UDP: "IPv4 packets that are not UDP",
    NO_TIME: "packets without a time of capture",
    OTHER_SIZE: f"UDP packets of other sizes than a Velodyne's {PACKET_BYTES} bytes",
    POSITION: "position packets (GPS), which are not used",
    TOO_MANY: f"packets of more than {MAX_LIDARS} lidars",
    UNKNOWN_LINK: "packets of another link type than Ethernet, Linux cooked, loopback and raw IP",
}
"""Packets that are not read, by the name of their topic below /other_traffic."""


class PcapFile(Container):
    """One open capture; see `RecordingFile`.

    It is read once as a whole when it is opened, and 18 bytes per packet are kept.
    """

    ros_version: RosVersion = "no ROS"

    def _describe(self) -> None:
        times, positions, lidars = array("q"), array("q"), array("H")
        numbers: dict[tuple[bytes, int], int] = {}
        others: Counter[str] = Counter()
        first_ns, last_ns = 2**63, -1
        for packet in captured_packets(self._stream, self._losses):
            time_ns = packet.time_ns
            if time_ns >= 0:
                first_ns, last_ns = min(first_ns, time_ns), max(last_ns, time_ns)
            found = find_udp(packet.head, packet.size, packet.link_type)
            if isinstance(found, str):
                others[found] += 1
            elif found.size != PACKET_BYTES:
                others[POSITION if found.size == POSITION_BYTES else OTHER_SIZE] += 1
            elif time_ns < 0:
                others[NO_TIME] += 1
            else:
                key = found.source, found.port
                if key not in numbers and len(numbers) == MAX_LIDARS:
                    others[TOO_MANY] += 1
                    continue
                lidars.append(numbers.setdefault(key, len(numbers)))
                times.append(time_ns)
                positions.append(packet.position + found.data_at)
        self._channels = []
        for source, port in numbers:
            name = "_".join(map(str, [*source] if port == DATA_PORT else [*source, port]))
            self._channels.append(packet_channel(f"/velodyne_{name}/packets"))
        self._times = np.array(times, np.int64)
        self._positions = np.array(positions, np.int64)
        self._lidars = np.array(lidars, np.uint16)
        counts = np.bincount(self._lidars, minlength=len(numbers)).tolist()
        self.topics = merge_topics(
            [TopicInfo(c.topic, c.msgtype, n, (c,)) for c, n in zip(self._channels, counts, strict=True) if n]
            + [TopicInfo(f"/other_traffic/{k}", "packet", n, (), OTHERS[k]) for k, n in others.items()]
        )
        self.message_count = len(self._times) + others.total()
        self.start_ns, self.end_ns = (first_ns, last_ns) if last_ns >= 0 else (0, 0)
        if not self.message_count and (losses := self.losses):
            raise EOFError(losses[0].reason)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = [number for number, channel in enumerate(self._channels) if topics is None or channel.topic in topics]
        taken = np.isin(self._lidars, wanted)
        if start_ns is not None:
            taken &= self._times >= start_ns
        if stop_ns is not None:
            taken &= self._times < stop_ns
        rows = np.flatnonzero(taken)
        rows = rows[np.argsort(self._times[rows], kind="stable")]
        self._check_open()
        columns = self._times, self._positions, self._lidars
        for part in np.array_split(rows, len(rows) // 4096 + 1):
            for time_ns, position, lidar in zip(*(column[part].tolist() for column in columns), strict=True):
                self._check_open()
                self._stream.seek(position)
                data = packet_message_data(time_ns, self._stream.read(PACKET_BYTES))
                yield RawMessage(time_ns, time_ns, (self._source.index, position), data, self._channels[lidar])
