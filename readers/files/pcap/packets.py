"""Packets in captures of network traffic (pcap and pcapng); damaged parts are skipped and noted.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng of the IETF, which describe what libpcap and Wireshark do.
No library suits damaged files: dpkt 1.9.8 gives neither the position of a packet nor whether the last one is cut short,
reads any length that a header names, knows one interface only, and rounds nanoseconds.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO, NamedTuple

import numpy as np

from pipeline.core.arrays import U32, Bools
from readers.files.damage import Losses

__all__ = ["CapturedPacket", "Window", "captured_packets", "is_capture"]

HEAD_BYTES = 160
"""First bytes of a packet that are examined: more than all headers before a Velodyne's data."""

MAX_BYTES = 262_144
"""Largest packet: libpcap's limit on what it captures."""

MAX_BLOCK_BYTES = 16 << 20
"""Largest block of pcapng: Wireshark's limit."""

LAST_NS = 2**32 * 10**9
"""Times from here on are invalid: ROS stamps end here."""

PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"

PCAP_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000, 16),
    b"\xa1\xb2\xc3\xd4": (">", 1000, 16),
    b"\x4d\x3c\xb2\xa1": ("<", 1, 16),
    b"\xa1\xb2\x3c\x4d": (">", 1, 16),
    b"\x34\xcd\xb2\xa1": ("<", 1000, 24),
    b"\xa1\xb2\xcd\x34": (">", 1000, 24),
}
"""Byte order, nanoseconds of the fraction's unit and bytes of a packet's header (24: modified by A. Kuznetsov)."""

_FILE_HEADER_BYTES = 24
_SAME_DAY_S = 86_400
_CHAINED = 3  # valid headers in a row that are required after damage


class CapturedPacket(NamedTuple):
    """One packet of a capture.

    Attributes:
        time_ns: When it was captured; -1 if unknown.
        link_type: Link type of its interface (https://www.tcpdump.org/linktypes.html); -1 if unknown.
        position: Its first byte in the file.
        size: Bytes that were captured.
        head: The first of these, at most `HEAD_BYTES`.
    """

    time_ns: int
    link_type: int
    position: int
    size: int
    head: bytes


def is_capture(magic: bytes) -> bool:
    """Whether a file that begins with these bytes is a capture."""
    return magic[:4] in PCAP_MAGICS or (magic[:4] == PCAPNG_MAGIC and magic[8:12] in _BYTE_ORDERS)


def captured_packets(stream: BinaryIO, losses: Losses) -> Iterator[CapturedPacket]:
    """The packets of a capture in the order of the file.

    Raises:
        EOFError: the file ends within its first header.
    """
    window = Window(stream)
    return _pcap(window, losses) if window.read(0, 4) in PCAP_MAGICS else _pcapng(window, losses)


class Window:
    """A buffered file that is read mostly at increasing positions.

    Attributes:
        size: Bytes of the file.
    """

    STEP = 1 << 18

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = stream.seek(0, 2)
        self._start = 0
        self._bytes = b""

    def read(self, position: int, size: int) -> bytes:
        """`size` bytes from `position` on, fewer at the end of the file."""
        at = position - self._start
        if at < 0 or at + size > len(self._bytes):
            self._stream.seek(position)
            self._start, self._bytes, at = position, self._stream.read(max(size, self.STEP)), 0
        return self._bytes[at : at + size]

    def glance(self, position: int, size: int) -> bytes:
        """The same for a few bytes elsewhere, without changing the buffer."""
        at = position - self._start
        if 0 <= at <= len(self._bytes) - size:
            return self._bytes[at : at + size]
        self._stream.seek(position)
        return self._stream.read(size)


# --- pcap


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the packets of a pcap file are laid out.

    Attributes:
        order: Byte order.
        header: Seconds, fraction, bytes captured, bytes on the wire.
        header_bytes: Size of a header.
        unit_ns: Unit of the fraction.
    """

    order: str
    header: struct.Struct
    header_bytes: int
    unit_ns: int

    def is_plausible(self, fields: tuple[int, int, int, int]) -> bool:
        """Whether the fields of a header are plausible."""
        _, fraction, captured, _ = fields
        return fraction * self.unit_ns < 10**9 and captured <= MAX_BYTES

    def fits(self, window: Window, position: int, fields: tuple[int, int, int, int]) -> bool:
        """Whether a plausible header fits at a position.

        If more bytes were captured than were on the wire, as some programs write, a plausible one has to follow it.
        """
        end = position + self.header_bytes + fields[2]
        if fields[2] <= fields[3] or end == window.size:
            return end <= window.size
        following = window.glance(end, self.header.size)
        return len(following) == self.header.size and self.is_plausible(self.header.unpack(following))


def _pcap(window: Window, losses: Losses) -> Iterator[CapturedPacket]:
    begin = window.read(0, _FILE_HEADER_BYTES)
    if len(begin) < _FILE_HEADER_BYTES:
        raise EOFError(f"its header has {len(begin)} of {_FILE_HEADER_BYTES} bytes")
    order, unit_ns, header_bytes = PCAP_MAGICS[begin[:4]]
    link_type = struct.unpack_from(f"{order}I", begin, 20)[0] & 0x0FFF_FFFF  # the other bits are about checksums
    layout = _Layout(order, struct.Struct(f"{order}IIII"), header_bytes, unit_ns)
    position, near_s = _FILE_HEADER_BYTES, None
    while position < window.size:
        record = window.read(position, header_bytes + HEAD_BYTES)
        data_at = position + header_bytes
        if len(record) < header_bytes:
            losses.note(position, "the file ends in the header of a packet", size=window.size - position, messages=1)
            return
        fields = layout.header.unpack_from(record)
        seconds, fraction, captured, _ = fields
        is_plausible = layout.is_plausible(fields)
        near_s = seconds if near_s is None and is_plausible else near_s
        if not is_plausible or not layout.fits(window, position, fields):
            after = _next_pcap_packet(window, position + 1, layout, near_s)
            if after is None and is_plausible and data_at + captured > window.size:
                reason = f"a packet is cut off: expected {captured} bytes, found {window.size - data_at}"
                losses.note(position, reason, size=window.size - position, messages=1)
                return
            end = window.size if after is None else after
            losses.note(position, "an invalid packet header", size=end - position)
            position = end
            continue
        near_s = seconds
        head = record[header_bytes : header_bytes + captured]
        yield CapturedPacket(seconds * 10**9 + fraction * unit_ns, link_type, data_at, captured, head)
        position = data_at + captured


def _next_pcap_packet(window: Window, position: int, layout: _Layout, near_s: int | None) -> int | None:
    """Where the first packet from `position` on begins; None if there is none.

    Several plausible headers in a row are required, within a day of the last packet before the damage.
    """

    def begins(at: int) -> bool:
        for count in range(1, _CHAINED + 1):
            fields = layout.header.unpack(window.glance(at, layout.header.size))
            if not layout.is_plausible(fields) or not 0 < fields[2] <= fields[3] <= MAX_BYTES:
                return False
            at += layout.header_bytes + fields[2]
            if at + layout.header_bytes > window.size:
                return at == window.size or count > 1
        return True

    def likely(words: U32) -> Bools:
        seconds, fraction, captured, length = words.T
        found = (fraction < 10**9 // layout.unit_ns) & (captured > 0) & (captured <= length) & (length <= MAX_BYTES)
        if near_s is not None:
            found &= np.abs(seconds.astype(np.int64) - near_s) <= _SAME_DAY_S
        return np.asarray(found)

    return _search(window, position, layout.order, 4, likely, begins)


# --- pcapng

SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, PACKET = 0x0A0D0D0A, 1, 2, 3, 6

_BYTE_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_KNOWN_BLOCKS = np.array([SECTION, 1, 2, 3, 4, 5, 6, 9, 10], np.uint32)
_TIME_RESOLUTION, _TIME_OFFSET = 9, 14


@dataclass(frozen=True, slots=True)
class _Interface:
    """What a file says about one interface.

    Attributes:
        link_type: Its link type.
        ticks: Ticks of its clock per second.
        offset_s: Offset of its times.
    """

    link_type: int
    ticks: int
    offset_s: int

    def time_ns(self, high: int, low: int) -> int:
        """Time of a packet; -1 if it is invalid."""
        time_ns = (high << 32 | low) * 10**9 // self.ticks + self.offset_s * 10**9
        return time_ns if 0 <= time_ns < LAST_NS else -1


_UNKNOWN = _Interface(-1, 1, 0)


def _pcapng(window: Window, losses: Losses) -> Iterator[CapturedPacket]:
    order, interfaces = "<", list[_Interface]()
    position = 0
    while position < window.size:
        block = window.read(position, 28 + HEAD_BYTES)
        if block[:4] == PCAPNG_MAGIC and block[8:12] in _BYTE_ORDERS:
            order, interfaces = _BYTE_ORDERS[block[8:12]], []
        size = _block_size(window, position, order)
        if size is None:
            end = _next_block(window, position + 1, order)
            cut_short = end is None and len(block) >= 8
            reason = "the file ends in a block" if cut_short else "a block whose two lengths differ"
            end = window.size if end is None else end
            losses.note(position, reason, size=end - position)
            position = end
            continue
        (kind,) = struct.unpack_from(f"{order}I", block)
        if kind == INTERFACE and size >= 20:
            interfaces.append(_interface(window.read(position + 8, min(size, 4096) - 12), order))
        elif kind in {PACKET, OLD_PACKET, SIMPLE_PACKET} and (fields := _packet_fields(block, size, kind, order)):
            number, high, low, captured, data_at = fields
            interface = interfaces[number] if number < len(interfaces) else _UNKNOWN
            time_ns = -1 if kind == SIMPLE_PACKET else interface.time_ns(high, low)
            head = block[data_at : data_at + captured]
            yield CapturedPacket(time_ns, interface.link_type, position + data_at, captured, head)
        elif kind in {PACKET, OLD_PACKET, SIMPLE_PACKET, INTERFACE}:
            losses.note(position, "a block that is shorter than its content", size=size)
        elif kind not in {SECTION, INTERFACE} and _looks_like_packet(block, size, order, len(interfaces)):
            losses.note(position, f"a packet in a block of type {kind}: its type was damaged", size=size, messages=1)
        position += size


def _block_size(window: Window, position: int, order: str) -> int | None:
    """Size of a block, which is repeated at its end; None if the two differ."""
    begin = window.glance(position, 8)
    if len(begin) < 8:
        return None
    (size,) = struct.unpack_from(f"{order}I", begin, 4)
    if size < 12 or size % 4 or size > MAX_BLOCK_BYTES or position + size > window.size:
        return None
    return size if window.glance(position + size - 4, 4) == begin[4:] else None


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


def _looks_like_packet(block: bytes, size: int, order: str, interfaces: int) -> bool:
    """Whether a block of another type has the form of a packet's, without options."""
    if size < 32 or (fields := _packet_fields(block, size, PACKET, order)) is None:
        return False
    number, _, _, captured, _ = fields
    (length,) = struct.unpack_from(f"{order}I", block, 24)
    return number < interfaces and 0 < captured <= length <= MAX_BYTES and 32 + (captured + 3) // 4 * 4 == size


def _interface(body: bytes, order: str) -> _Interface:
    (link_type,) = struct.unpack_from(f"{order}H", body)
    ticks, offset_s, at = 10**6, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _TIME_RESOLUTION and len(value) == 1:
            ticks = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _TIME_OFFSET and len(value) == 8:
            (offset_s,) = struct.unpack(f"{order}q", value)
        elif code == 0:
            break
        at += 4 + (size + 3) // 4 * 4
    return _Interface(link_type, ticks, offset_s)


def _next_block(window: Window, position: int, order: str) -> int | None:
    """Where the first block from `position` on begins; None if there is none."""

    def likely(words: U32) -> Bools:
        kind, size = words.T
        return np.asarray(np.isin(kind, _KNOWN_BLOCKS) & (size >= 12) & (size % 4 == 0) & (size <= MAX_BLOCK_BYTES))

    return _search(window, position, order, 2, likely, lambda at: _block_size(window, at, order) is not None)


# --- after damage


def _search(
    window: Window,
    position: int,
    order: str,
    count: int,
    likely: Callable[[U32], Bools],
    begins: Callable[[int], bool],
) -> int | None:
    """The first position from `position` on for which `begins` is true; None if there is none.

    Args:
        window: The file.
        position: Where the search begins.
        order: Byte order.
        count: Number of words that `likely` examines.
        likely: Tells from (n, count) words, the first ones at each of n positions, which positions to try.
        begins: Tells for certain.
    """
    step = 1 << 12
    while position + 4 * count <= window.size:
        content = window.read(position, step + 4 * count)
        places = len(content) - 4 * count + 1
        words = np.ndarray((places, count), f"{order}u4", content, 0, (1, 4))
        for place in np.flatnonzero(likely(words)).tolist():
            if begins(position + place):
                return position + place
        position += places
        step = min(2 * step, 1 << 20)
    return None
