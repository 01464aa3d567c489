"""UDP packets in captured ones, also those that IP sent in fragments: an Ouster's are longer than Ethernet's frames."""

from typing import NamedTuple

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
