"""UDP packets in captured network packets: sender, port, and where their data are."""

from ipaddress import ip_address
from typing import NamedTuple

__all__ = ["CUT_SHORT", "FRAGMENTS", "NOT_IP", "NOT_UDP", "UNKNOWN_LINK", "Udp", "address_text", "find_udp"]

ETHERNET, RAW_IP, SLL, SLL2 = 1, frozenset({12, 14, 101, 228, 229}), 113, 276
NULL, LOOP = 0, 108
VLAN_TAGS = frozenset({0x8100, 0x88A8, 0x9100})
IPV4, IPV6 = 0x0800, 0x86DD
UDP, FRAGMENT = 17, 44
EXTENSIONS = frozenset({0, 43, 60})
"""IPv6 headers that contain their own length: hop-by-hop options, routing, destination options."""

# What a packet is if it is not UDP.
CUT_SHORT = "cut_short"
FRAGMENTS = "fragments"
NOT_IP = "not_ip"
NOT_UDP = "not_udp"
UNKNOWN_LINK = "unknown_link"


class Udp(NamedTuple):
    """A UDP packet.

    Attributes:
        source: Address of the sender, 4 or 16 bytes.
        port: Destination port.
        data_at: Offset of its data in the captured packet.
        size: Bytes of its data.
    """

    source: bytes
    port: int
    data_at: int
    size: int


def address_text(address: bytes) -> str:
    """An IP address as text."""
    return str(ip_address(address))


def find_udp(head: bytes, captured: int, link_type: int) -> Udp | str:
    """The UDP packet in a captured packet, or one of the words above that says what it is instead.

    Args:
        head: First bytes of the captured packet.
        captured: Its size in bytes.
        link_type: Link type of the interface.
    """
    try:
        found = _ip(head, link_type)
        if isinstance(found, str):
            return found
        at, version = found
        return _ipv4(head, at, captured) if version == 4 else _ipv6(head, at, captured)
    except IndexError:
        return CUT_SHORT


def _u16(head: bytes, at: int) -> int:
    return head[at] << 8 | head[at + 1]


def _ip(head: bytes, link_type: int) -> tuple[int, int] | str:
    """Where the IP packet begins, and its version; or what the packet is instead."""
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
        kind = {4: IPV4, 6: IPV6}.get(head[at] >> 4, 0)
    else:
        return UNKNOWN_LINK
    if kind == IPV4:
        return at, 4
    return (at, 6) if kind == IPV6 else NOT_IP


def _ipv4(head: bytes, at: int, captured: int) -> Udp | str:
    if _u16(head, at + 6) & 0x3FFF:  # more fragments, or not the first one
        return FRAGMENTS
    if head[at + 9] != UDP:
        return NOT_UDP
    return _udp(head, at + 4 * (head[at] & 0x0F), head[at + 12 : at + 16], captured)


def _ipv6(head: bytes, at: int, captured: int) -> Udp | str:
    kind, source, at = head[at + 6], head[at + 8 : at + 24], at + 40
    while kind in EXTENSIONS:
        kind, at = head[at], at + 8 * (head[at + 1] + 1)
    if kind == FRAGMENT:
        return FRAGMENTS
    return _udp(head, at, source, captured) if kind == UDP else NOT_UDP


def _udp(head: bytes, at: int, source: bytes, captured: int) -> Udp | str:
    port, size = _u16(head, at + 2), _u16(head, at + 4) - 8
    if size < 0 or at + 8 + size > captured:
        return CUT_SHORT
    return Udp(source, port, at + 8, size)
