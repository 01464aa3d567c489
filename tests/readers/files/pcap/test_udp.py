import struct

import dpkt
import pytest
from captures import ethernet, ip_packet

from lidcam.readers.files.pcap.udp import CUT_SHORT, FRAGMENTS, NOT_IPV4, NOT_UDP, UNKNOWN_LINK, Udp, find_udp

DATA = b"velodyne" * 20
IPV4 = bytes(ip_packet(DATA))
IPV6 = bytes(ip_packet(DATA, "fe80::7"))
VLAN, SERVICE_VLAN = struct.pack(">HH", 5, 0x0800), struct.pack(">HHHH", 5, 0x8100, 6, 0x0800)


def with_flags(flags: int) -> bytes:
    return IPV4[:6] + struct.pack(">H", flags) + IPV4[8:]


def found(packet: bytes, link_type: int = 1, captured: int | None = None) -> Udp | str:
    captured = len(packet) if captured is None else captured
    return find_udp(packet[: min(captured, 160)], captured, link_type)


@pytest.mark.parametrize(
    ("packet", "link_type"),
    [
        (ethernet(IPV4), 1),
        (ethernet(VLAN + IPV4, 0x8100), 1),
        (ethernet(SERVICE_VLAN + IPV4, 0x88A8), 1),
        (bytes(dpkt.sll.SLL(type=0, hrd=1, hlen=6, ethtype=0x0800, data=IPV4)), 113),
        (bytes(dpkt.sll2.SLL2(ethtype=0x0800, data=IPV4)), 276),
        (IPV4, 101),
        (IPV4, 228),
        (with_flags(0x4000), 101),  # not to be fragmented
        (b"\2\0\0\0" + IPV4, 0),
        (b"\0\0\0\2" + IPV4, 108),
        (bytes(ip_packet(DATA, hl=7, opts=bytes(8))), 101),
        (ethernet(bytes(dpkt.ip.IP(src=b"\xc0\xa8\1\xc9", p=17, data=dpkt.ip.IP(IPV4).data)) + b"padding"), 1),
    ],
)
def test_ipv4_on_every_link(packet: bytes, link_type: int) -> None:
    udp = found(packet, link_type)
    assert isinstance(udp, Udp)
    assert (udp.source, udp.port) == (bytes([192, 168, 1, 201]), 2368)
    assert packet[udp.data_at : udp.data_at + udp.size] == DATA


@pytest.mark.parametrize(
    ("packet", "link_type", "kind"),
    [
        (ethernet(b"\0" * 28, 0x0806), 1, NOT_IPV4),
        (IPV4[:9] + b"\6" + IPV4[10:], 101, NOT_UDP),
        (IPV6, 101, NOT_IPV4),
        (with_flags(0x2000), 101, FRAGMENTS),
        (with_flags(0x00B9), 101, FRAGMENTS),
        (ethernet(IPV4), 147, UNKNOWN_LINK),
        (ethernet(IPV4), -1, UNKNOWN_LINK),
        (b"", 1, CUT_SHORT),
        (b"", 101, CUT_SHORT),
        (IPV4[:24] + b"\0\7" + IPV4[26:], 101, CUT_SHORT),
    ],
)
def test_what_is_no_udp_packet_is_named(packet: bytes, link_type: int, kind: str) -> None:
    assert found(packet, link_type) == kind
