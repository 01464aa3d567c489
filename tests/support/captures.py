"""Captures of network traffic, written by hand in every form, and the packets in them, by dpkt."""

import struct
from collections.abc import Iterable, Sequence
from ipaddress import ip_address
from typing import Any

import dpkt

from lidcam.pipeline.core.arrays import I64, U8

PCAP_FORMS = {
    "little, us": ("<", 0xA1B2C3D4, 1000),
    "big, us": (">", 0xA1B2C3D4, 1000),
    "little, ns": ("<", 0xA1B23C4D, 1),
    "big, ns": (">", 0xA1B23C4D, 1),
}
"""Byte order, magic number, and nanoseconds of a tick."""


# --- packets


def ip_packet(payload: bytes, source: str = "192.168.1.201", port: int = 2368, **fields: Any) -> Any:
    """An IPv4 or IPv6 packet of UDP; `fields` go to its header."""
    address, udp = ip_address(source), dpkt.udp.UDP(sport=port, dport=port, data=payload)
    udp.ulen = len(udp)
    if address.version == 6:
        return dpkt.ip6.IP6(src=address.packed, dst=bytes(16), nxt=17, hlim=64, plen=len(udp), data=udp, **fields)
    packet = dpkt.ip.IP(src=address.packed, dst=b"\xff" * 4, p=17, data=udp, **fields)
    packet.len = len(packet)
    return packet


def ethernet(data: Any, kind: int | None = None) -> bytes:
    """A frame with an IP packet, or with bytes of another kind."""
    if kind is None:
        kind = dpkt.ethernet.ETH_TYPE_IP6 if isinstance(data, dpkt.ip6.IP6) else dpkt.ethernet.ETH_TYPE_IP
    return bytes(6) + b"\xff" * 6 + struct.pack(">H", kind) + bytes(data)


def fragments(packet: Any, most: int = 1480) -> list[bytes]:
    """The frames of an IPv4 packet whose data is sent in parts of at most `most` bytes, a multiple of eight."""
    data, frames = bytes(packet.data), []
    for at in range(0, len(data), most):
        part = dpkt.ip.IP(src=packet.src, dst=packet.dst, p=packet.p, id=packet.id, data=data[at : at + most])
        part.len, part.offset, part.mf = len(part), at // 8, int(at + most < len(data))
        frames.append(ethernet(bytes(part)))
    return frames


# --- pcap


def pcap(packets: Iterable[tuple[int, bytes]], form: str = "little, ns", link_type: int = 1) -> bytes:
    """A file of (time in nanoseconds, packet)."""
    order, magic, tick_ns = PCAP_FORMS[form]
    parts = [struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)]
    for time_ns, packet in packets:
        sec, rest_ns = divmod(time_ns, 10**9)
        parts.append(struct.pack(f"{order}IIII", sec, rest_ns // tick_ns, len(packet), len(packet)) + packet)
    return b"".join(parts)


def capture_of(payload: U8, stamps_ns: I64, source: str = "192.168.1.201", port: int = 2368) -> list[tuple[int, bytes]]:
    """What a Velodyne sent, for `pcap`."""
    return [
        (at, ethernet(ip_packet(data.tobytes(), source, port)))
        for at, data in zip(stamps_ns.tolist(), payload, strict=True)
    ]


# --- pcapng


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """Any block."""
    body += bytes(-len(body) % 4)
    size = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + size + body + size


def section(order: str = "<") -> bytes:
    """The begin of a section."""
    return block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(link_type: int = 1, options: Sequence[tuple[int, bytes]] = ((9, b"\x09"),), order: str = "<") -> bytes:
    """An interface with options (code, value); by default its times are nanoseconds."""
    body = struct.pack(f"{order}HHI", link_type, 0, 0)
    for code, value in (*options, (0, b"")):
        body += struct.pack(f"{order}HH", code, len(value)) + value + bytes(-len(value) % 4)
    return block(1, body, order)


def ng_packet(ticks: int, packet: bytes, number: int = 0, order: str = "<", kind: int = 6) -> bytes:
    """A packet of an interface: an Enhanced Packet Block, a Simple one (3) or an old one (2)."""
    if kind == 3:
        return block(3, struct.pack(f"{order}I", len(packet)) + packet, order)
    layout = "IIIII" if kind == 6 else "HxxIIII"
    fields = (number, ticks >> 32, ticks & 0xFFFF_FFFF, len(packet), len(packet))
    return block(kind, struct.pack(f"{order}{layout}", *fields) + packet, order)
