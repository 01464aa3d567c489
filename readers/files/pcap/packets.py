"""Packets in captures of network traffic (pcap and pcapng), up to the first damage; what is behind it is one loss.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng of the IETF, which describe what libpcap and Wireshark do.
dpkt 1.9.8 takes half as long again, knows the clock and link of one interface only, rounds nanoseconds, and passes over
packets of other blocks without a word.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from lidcam.readers.files.damage import Losses

HEAD_BYTES = 160
"""First bytes of a packet that are examined: more than all headers before a Velodyne's data."""

MAX_BYTES = 262_144
"""Largest packet: libpcap's limit on what it captures."""

MAX_BLOCK_BYTES = 16 << 20
"""Largest block of pcapng: Wireshark's limit."""

END_OF_TIME_NS = 2**32 * 10**9
"""End of ROS stamps: times from here on are invalid."""

PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"

PCAP_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order, and nanoseconds of the fraction's unit."""

_FILE_HEADER_BYTES, _PACKET_HEADER_BYTES = 24, 16


class CapturedPacket(NamedTuple):
    """One packet of a capture."""

    time_ns: int  # When it was captured; -1 if unknown
    link_type: int  # Link type of its interface (https://www.tcpdump.org/linktypes.html); -1 if unknown
    position: int  # Its first byte in the file
    size: int  # Bytes that were captured
    head: bytes  # The first of these, at most `HEAD_BYTES`


def is_capture(magic: bytes) -> bool:
    """Whether a file that begins with these bytes is a capture."""
    return magic[:4] in PCAP_MAGICS or (magic[:4] == PCAPNG_MAGIC and magic[8:12] in _BYTE_ORDERS)


def captured_packets(stream: BinaryIO, losses: Losses) -> Iterator[CapturedPacket]:
    """The packets of a capture in the order of the file; raises EOFError if the file ends within its first header."""
    end = stream.seek(0, 2)
    stream.seek(0)
    begin = stream.read(_FILE_HEADER_BYTES)
    return _pcap(stream, begin, end, losses) if begin[:4] in PCAP_MAGICS else _pcapng(stream, end, losses)


# --- pcap


def _pcap(stream: BinaryIO, begin: bytes, end: int, losses: Losses) -> Iterator[CapturedPacket]:
    if len(begin) < _FILE_HEADER_BYTES:
        raise EOFError(f"its header has {len(begin)} of {_FILE_HEADER_BYTES} bytes")
    order, unit_ns = PCAP_MAGICS[begin[:4]]
    link_type = struct.unpack_from(f"{order}I", begin, 20)[0] & 0x0FFF_FFFF  # the other bits are about checksums
    header = struct.Struct(f"{order}IIII")  # seconds, fraction, bytes captured, bytes on the wire
    position = _FILE_HEADER_BYTES
    while position < end:
        stream.seek(position)
        record, left = stream.read(_PACKET_HEADER_BYTES + HEAD_BYTES), end - position
        if left < _PACKET_HEADER_BYTES:
            losses.note(position, "the file ends in the header of a packet", size=left, messages=1)
            return
        seconds, fraction, captured, length = header.unpack_from(record)
        if fraction * unit_ns >= 10**9 or captured > MAX_BYTES:
            losses.note(position, "an invalid packet header; what is behind it is not read", size=left)
            return
        if _PACKET_HEADER_BYTES + captured > left:
            reason = f"a packet is cut off: expected {captured} bytes, found {left - _PACKET_HEADER_BYTES}"
            losses.note(position, reason, size=left, messages=1 if captured <= length else None)
            return
        head = record[_PACKET_HEADER_BYTES : _PACKET_HEADER_BYTES + captured]
        data_at = position + _PACKET_HEADER_BYTES
        yield CapturedPacket(seconds * 10**9 + fraction * unit_ns, link_type, data_at, captured, head)
        position = data_at + captured


# --- pcapng

INTERFACE, OLD_PACKET, SIMPLE_PACKET, PACKET = 1, 2, 3, 6

_BYTE_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_PACKETS = frozenset({OLD_PACKET, SIMPLE_PACKET, PACKET})
_TIME_RESOLUTION, _TIME_OFFSET = 9, 14


class _Interface(NamedTuple):
    """One interface of a capture: its link type, and its clock."""

    link_type: int = -1
    ticks_per_s: int = 1
    offset_s: int = 0

    def time_ns(self, high: int, low: int) -> int:
        """Time of a packet; -1 if it is invalid."""
        time_ns = (high << 32 | low) * 10**9 // self.ticks_per_s + self.offset_s * 10**9
        return time_ns if 0 <= time_ns < END_OF_TIME_NS else -1


def _pcapng(stream: BinaryIO, end: int, losses: Losses) -> Iterator[CapturedPacket]:
    order, interfaces = "<", list[_Interface]()
    position = 0
    while position < end:
        stream.seek(position)
        block = stream.read(28 + HEAD_BYTES)
        if block[:4] == PCAPNG_MAGIC and block[8:12] in _BYTE_ORDERS:
            order, interfaces = _BYTE_ORDERS[block[8:12]], []
        kind, size = struct.unpack_from(f"{order}II", block) if len(block) >= 12 else (0, 0)
        fields, reason = None, ""
        if size < 12 or size % 4 or size > MAX_BLOCK_BYTES:
            reason = "a block of an invalid length"
        elif position + size > end:
            reason = "the file ends in a block"
        elif kind in _PACKETS and (fields := _packet_fields(block, size, kind, order)) is None:
            reason = "a block that is shorter than its content"
        else:
            stream.seek(position + size - 4)
            reason = "" if stream.read(4) == block[4:8] else "a block whose two lengths differ"
        if reason:
            losses.note(position, f"{reason}; what is behind it is not read", size=end - position)
            return
        if kind == INTERFACE:
            stream.seek(position + 8)
            interfaces.append(_interface(stream.read(min(size, 4096) - 12), order))
        elif fields is not None:
            number, high, low, captured, data_at = fields
            interface = interfaces[number] if number < len(interfaces) else _Interface()
            time_ns = -1 if kind == SIMPLE_PACKET else interface.time_ns(high, low)
            head = block[data_at : data_at + captured]
            yield CapturedPacket(time_ns, interface.link_type, position + data_at, captured, head)
        position += size


def _packet_fields(block: bytes, size: int, kind: int, order: str) -> tuple[int, int, int, int, int] | None:
    """Interface, both halves of the time, bytes captured and their offset in the block; None if they do not fit it."""
    if kind == SIMPLE_PACKET:
        captured, data_at = min(struct.unpack_from(f"{order}I", block, 8)[0], size - 16), 12
        return (0, 0, 0, captured, data_at) if captured >= 0 else None
    if size < 32:
        return None
    layout = f"{order}IIII" if kind == PACKET else f"{order}HxxIII"
    number, high, low, captured = struct.unpack_from(layout, block, 8)
    return (number, high, low, captured, 28) if captured <= size - 32 else None


def _interface(body: bytes, order: str) -> _Interface:
    link_type = int.from_bytes(body[:2], "little" if order == "<" else "big")
    ticks_per_s, offset_s, at = 10**6, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _TIME_RESOLUTION and len(value) == 1:
            ticks_per_s = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _TIME_OFFSET and len(value) == 8:
            (offset_s,) = struct.unpack(f"{order}q", value)
        elif code == 0:
            break
        at += 4 + (size + 3) // 4 * 4
    return _Interface(link_type, ticks_per_s, offset_s)


ETHERNET, RAW_IP, SLL, SLL2 = 1, frozenset({12, 14, 101, 228, 229}), 113, 276
NULL, LOOP = 0, 108
VLAN_TAGS = frozenset({0x8100, 0x88A8, 0x9100})
IPV4 = 0x0800
UDP, UDP_HEADER_BYTES = 17, 8

# Kinds of packets that are not UDP.
CUT_SHORT = "cut_short"
FRAGMENTS = "fragments"
NOT_IPV4 = "not_ipv4"
NOT_UDP = "not_udp"
UNKNOWN_LINK = "unknown_link"


class Datagram(NamedTuple):
    """A UDP packet, captured whole or put together from fragments."""

    source: bytes  # Address of the sender, 4 bytes
    port: int  # Destination port
    pieces: list[tuple[int, int]]  # Places and sizes in the file of its data


class Fragment(NamedTuple):
    """A part of a UDP packet that was sent in several."""

    packet: tuple[bytes, int]  # Addresses of sender and receiver, and the number that the sender gave the packet
    offset: int  # Of its bytes in the packet, whose first 8 are UDP's header
    is_last: bool
    data_at: int  # Offset of its bytes in the captured packet
    size: int  # Number of its bytes


def find_udp(head: bytes, position: int, captured: int, link_type: int) -> Datagram | str:
    """The UDP packet in one of `captured` bytes at `position` that begins with `head`; or one of the kinds above."""
    try:
        at = _ipv4_begin(head, link_type)
        return at if isinstance(at, str) else _udp(head, at, position, captured)
    except IndexError:
        return CUT_SHORT


def find_fragment(head: bytes, captured: int, link_type: int) -> Fragment | None:
    """The fragment in a packet of which `find_udp` says so; None if it is none of UDP, or was not captured whole."""
    try:
        at = _ipv4_begin(head, link_type)
        if isinstance(at, str) or head[at + 9] != UDP:
            return None
        data_at = at + 4 * (head[at] & 0x0F)
        size, flags = at + _u16(head, at + 2) - data_at, _u16(head, at + 6)
    except IndexError:
        return None
    if size <= 0 or data_at + size > captured:
        return None
    key = head[at + 12 : at + 20], _u16(head, at + 4)
    return Fragment(key, 8 * (flags & 0x1FFF), not flags & 0x2000, data_at, size)


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


def _udp(head: bytes, at: int, position: int, captured: int) -> Datagram | str:
    if _u16(head, at + 6) & 0x3FFF:  # more fragments, or not the first one
        return FRAGMENTS
    if head[at + 9] != UDP:
        return NOT_UDP
    source = head[at + 12 : at + 16]
    at += 4 * (head[at] & 0x0F)
    port, size = _u16(head, at + 2), _u16(head, at + 4) - 8
    if size < 0 or at + 8 + size > captured:
        return CUT_SHORT
    return Datagram(source, port, [(position + at + UDP_HEADER_BYTES, size)])


MAX_OPEN = 256
"""Packets of which fragments may be missing at a time."""


MAX_SPAN_BYTES = 8 << 20
"""Maximum distance in the file between fragments of one packet; the numbers of packets begin again after 65,536."""


class Reassembly:
    """Puts packets together from fragments, in whatever order they come; those that lack some are given up in turn.

    Attributes:
        given_up: Number of fragments of packets that were never complete.
    """

    def __init__(self) -> None:
        self._open: dict[tuple[bytes, int], dict[int, tuple[Fragment, int, bytes]]] = {}
        self.given_up = 0

    def add(self, fragment: Fragment, position: int, head: bytes) -> Datagram | None:
        """Add a fragment of the packet captured at `position`; returns the packet that it completes."""
        while self._open:
            first, parts = next(iter(self._open.items()))
            if position - next(iter(parts.values()))[1] <= MAX_SPAN_BYTES:
                break
            self.given_up += len(self._open.pop(first))
        parts = self._open.setdefault(fragment.packet, {})
        parts[fragment.offset] = fragment, position + fragment.data_at, head[fragment.data_at :]
        if len(self._open) > MAX_OPEN:
            self.given_up += len(self._open.pop(next(iter(self._open))))
        ordered = [parts[offset] for offset in sorted(parts)]
        end = 0
        for part, _, _ in ordered:
            if part.offset != end:
                return None
            end += part.size
        if not ordered[-1][0].is_last or len(ordered[0][2]) < UDP_HEADER_BYTES:
            return None
        self._open.pop(fragment.packet, None)
        pieces = [(at, part.size) for part, at, _ in ordered]
        first_at, first_size = pieces[0]
        pieces[0] = first_at + UDP_HEADER_BYTES, first_size - UDP_HEADER_BYTES
        return Datagram(fragment.packet[0][:4], _u16(ordered[0][2], 2), pieces)

    def close(self) -> int:
        """Number of fragments that are in no packet."""
        return self.given_up + sum(map(len, self._open.values()))
