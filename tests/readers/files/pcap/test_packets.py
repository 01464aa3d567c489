import io
import struct
from pathlib import Path

import dpkt
import pytest
from captures import PCAP_FORMS, block, interface, ng_packet, pcap, section

from lidcam.readers.files.damage import Losses
from lidcam.readers.files.pcap.packets import CapturedPacket, captured_packets, is_capture

AT_NS = 1_600_000_000_123_456_000
PACKETS = [(AT_NS + n * 1_000_000, bytes([n]) * (40 + n)) for n in range(6)]


def pcapng(order: str = "<") -> bytes:
    body = [ng_packet(at, packet, order=order) for at, packet in PACKETS]
    return section(order) + interface(order=order) + b"".join(body)


FILES = {form: pcap(PACKETS, form) for form in PCAP_FORMS} | {"ng, little": pcapng("<"), "ng, big": pcapng(">")}


def read(content: bytes) -> tuple[list[CapturedPacket], list[tuple[int, str, int | None, int | None]]]:
    losses = Losses(Path("a.pcap"))
    packets = list(captured_packets(io.BytesIO(content), losses))
    return packets, [(loss.position, loss.reason, loss.size, loss.messages) for loss in losses.listed()]


def found(content: bytes) -> list[tuple[int, bytes]]:
    packets, losses = read(content)
    assert losses == []
    assert all(content[p.position : p.position + p.size].startswith(p.head) for p in packets)
    return [(packet.time_ns, content[packet.position : packet.position + packet.size]) for packet in packets]


# --- sound files


@pytest.mark.parametrize("form", FILES)
def test_every_form_as_dpkt_reads_it(form: str) -> None:
    assert is_capture(FILES[form][:64])
    assert found(FILES[form]) == PACKETS
    assert {packet.link_type for packet in read(FILES[form])[0]} == {1}
    theirs = list(dpkt.pcap.UniversalReader(io.BytesIO(FILES[form])))
    assert [packet for _, packet in theirs] == [packet for _, packet in PACKETS]
    assert [float(at) for at, _ in theirs] == pytest.approx([at / 1e9 for at, _ in PACKETS], abs=1e-6)


@pytest.mark.parametrize(
    ("options", "ticks", "time_ns"),
    [
        ([], 1_600_000_000_123_456, AT_NS),
        ([(9, b"\x03")], 1_600_000_000_123, AT_NS - 456_000),
        ([(9, b"\x8a")], 1_600_000_000 * 1024 + 512, 1_600_000_000_500_000_000),
        ([(2, b"eth0"), (14, struct.pack("<q", 1_600_000_000))], 7, 1_600_000_000_000_007_000),
        ([(14, struct.pack("<q", -5))], 4_000_000, -1),
        ([(9, b"\x00")], 2**63, -1),
        ([(9, b"\x7f")], 2**63, 0),
    ],
)
def test_clocks_of_interfaces(options: list[tuple[int, bytes]], ticks: int, time_ns: int) -> None:
    content = section() + interface(options=options) + ng_packet(ticks, b"data")
    assert found(content) == [(time_ns, b"data")]


def test_blocks_of_every_kind() -> None:
    content = section() + interface(1) + interface(113, ()) + ng_packet(AT_NS // 1000, b"one", number=1)
    content += block(5, b"statistics") + block(0x0BAD, b"of the future")
    content += ng_packet(AT_NS, b"two", kind=2) + ng_packet(0, b"three", kind=3) + ng_packet(AT_NS, b"four", number=7)
    content += section(">") + interface(101, order=">") + ng_packet(AT_NS, b"five", order=">")
    packets, losses = read(content)
    assert losses == []
    assert [(packet.time_ns, packet.link_type, packet.head[: packet.size]) for packet in packets] == [
        (AT_NS, 113, b"one"),
        (AT_NS, 1, b"two"),
        (-1, 1, b"three"),
        (-1, -1, b"four"),
        (AT_NS, 101, b"five"),
    ]


# --- damaged files


@pytest.mark.parametrize("form", ["little, us", "ng, little", "ng, big"])
def test_cut_anywhere(form: str) -> None:
    content = FILES[form]
    whole, _ = read(content)
    ends = [packet.position + packet.size for packet in whole]
    if form.startswith("ng"):
        ends = [(end + 3) // 4 * 4 + 4 for end in ends]
    for size in range(28 if form.startswith("ng") else 24, len(content)):
        packets, losses = read(content[:size])
        assert packets == whole[: sum(end <= size for end in ends)]
        begins = {*ends, *([28, 28 + len(interface())] if form.startswith("ng") else [24])}
        assert len(losses) == (size not in begins)
        if losses:
            [(position, _, lost, _)] = losses
            assert position in begins
            assert lost == size - position


@pytest.mark.parametrize(
    ("form", "written"),
    [
        ("little, ns", b"\xff" * 16),
        ("big, us", b"\xfc\xff\xff\x7f" * 4),
        ("ng, little", b"\xfc\xff\xff\x7f" * 4),
        ("ng, big", b"\xff" * 16),
    ],
)
def test_packets_before_damage_are_read_and_the_rest_is_one_loss(form: str, written: bytes) -> None:
    content = bytearray(FILES[form])
    at = read(bytes(content))[0][2].position - (28 if form.startswith("ng") else 16)
    content[at : at + 16] = written
    packets, [(position, reason, size, messages)] = read(bytes(content))
    assert [packet.head for packet in packets] == [packet for _, packet in PACKETS[:2]]
    assert (position, size, messages) == (at, len(content) - at, None)
    assert "what is behind it is not read" in reason
