"""UDP packets over IPv4 in captured network packets: sender, port, and where their data are."""

from typing import NamedTuple

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
