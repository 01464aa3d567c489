import struct
from pathlib import Path

import dpkt
import numpy as np
import pytest
from captures import capture_of, ethernet, interface, ip_packet, ng_packet, pcap, section
from helpers import at_most
from velodyne import START_NS, random_packets

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.files.pcap.packets import (
    CUT_SHORT,
    FRAGMENTS,
    NOT_IPV4,
    NOT_UDP,
    UNKNOWN_LINK,
    Datagram,
    Fragment,
    Reassembly,
    find_udp,
)
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording

DATA = b"velodyne" * 20
IPV4 = bytes(ip_packet(DATA))
IPV6 = bytes(ip_packet(DATA, "fe80::7"))
VLAN, SERVICE_VLAN = struct.pack(">HH", 5, 0x0800), struct.pack(">HHHH", 5, 0x8100, 6, 0x0800)


def with_flags(flags: int) -> bytes:
    return IPV4[:6] + struct.pack(">H", flags) + IPV4[8:]


def found(packet: bytes, link_type: int = 1, captured: int | None = None) -> Datagram | str:
    captured = len(packet) if captured is None else captured
    return find_udp(packet[: min(captured, 160)], 0, captured, link_type)


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
    assert isinstance(udp, Datagram)
    assert (udp.source, udp.port) == (bytes([192, 168, 1, 201]), 2368)
    [(data_at, size)] = udp.pieces
    assert packet[data_at : data_at + size] == DATA


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


TOPIC = "/velodyne_192_168_1_201/packets"
PAYLOAD, STAMPS_NS = random_packets("VLP-16", packets=40, start=0)
CAPTURE = capture_of(PAYLOAD, STAMPS_NS)


def written(folder: Path, content: bytes, name: str = "velodyne.pcap") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def read(path: Path, *, start_ns: int | None = None, stop_ns: int | None = None) -> list[RawMessage]:
    with open_recording([path]) as recording:
        assert recording.losses == ()
        return list(recording.messages(start_ns=start_ns, stop_ns=stop_ns))


def payloads(messages: list[RawMessage]) -> list[bytes]:
    return [deserialize(message).data.tobytes() for message in messages]


# --- what is read


def test_packets_have_the_time_of_their_capture(tmp_path: Path) -> None:
    found = read(written(tmp_path, pcap(CAPTURE, "little, ns")))
    assert payloads(found) == [data.tobytes() for data in PAYLOAD]
    assert [message.stamp_ns for message in found] == STAMPS_NS.tolist()
    assert [message.log_time_ns for message in found] == STAMPS_NS.tolist()
    stamps = [deserialize(message).stamp for message in found]
    assert [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps] == STAMPS_NS.tolist()


def test_lidars_are_told_apart(tmp_path: Path) -> None:
    senders = [("192.168.1.202", 2368), ("192.168.1.201", 2369), ("192.168.1.201", 2368)]
    frames = [(START_NS + n, ethernet(ip_packet(PAYLOAD[n].tobytes(), *senders[n % 3]))) for n in range(len(PAYLOAD))]
    path = written(tmp_path, pcap(frames))
    with open_recording([path]) as recording:
        topics = {info.topic: info.message_count for info in recording.topics}
        assert topics == {
            "/velodyne_192_168_1_201/packets": 13,
            "/velodyne_192_168_1_201_2369/packets": 13,
            "/velodyne_192_168_1_202/packets": 14,
        }
        for topic, first in zip(topics, (2, 1, 0), strict=True):
            assert payloads(list(recording.messages([topic]))) == [data.tobytes() for data in PAYLOAD[first::3]]


def test_the_order_is_that_of_time(tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(len(CAPTURE))
    found = read(written(tmp_path, pcap([CAPTURE[n] for n in order])))
    assert payloads(found) == [data.tobytes() for data in PAYLOAD]
    same = read(written(tmp_path, pcap([(START_NS, frame) for _, frame in CAPTURE]), "same.pcap"))
    assert payloads(same) == [data.tobytes() for data in PAYLOAD]
    assert [m.order for m in same] == sorted(m.order for m in same)
    with open_recording([written(tmp_path, pcap([]), "none.pcap")]) as recording:
        assert (recording.message_count, recording.topics, recording.losses) == (0, (), ())


def test_other_traffic_is_counted(tmp_path: Path) -> None:
    fragment = ip_packet(PAYLOAD[0].tobytes())
    fragment.mf = 1
    frames = [
        ethernet(ip_packet(PAYLOAD[0].tobytes())),
        ethernet(ip_packet(bytes(512), port=8308)),
        ethernet(ip_packet(bytes(512), port=8308)),
        ethernet(ip_packet(b"who is there", port=53)),
        ethernet(fragment),
        ethernet(fragment)[:22],
        ethernet(b"who has", 0x0806),
        ethernet(ip_packet(PAYLOAD[0].tobytes()))[:900],
    ]
    path = written(tmp_path, pcap((START_NS + n, frame) for n, frame in enumerate(frames)))
    with open_recording([path]) as recording:
        found = {info.topic: (info.message_count, bool(info.unreadable)) for info in recording.topics}
        assert recording.message_count == 8
        assert len(list(recording.messages())) == 1
    assert found == {
        TOPIC: (1, False),
        "/other_traffic/cut_short": (1, True),
        "/other_traffic/fragments": (2, True),
        "/other_traffic/not_ipv4": (1, True),
        "/other_traffic/other_size": (1, True),
        "/other_traffic/position": (2, True),
    }


def test_packets_without_a_time_are_counted(tmp_path: Path) -> None:
    content = section() + interface() + ng_packet(0, CAPTURE[0][1], kind=3) + ng_packet(START_NS, CAPTURE[1][1])
    with open_recording([written(tmp_path, content)]) as recording:
        assert {i.topic: i.message_count for i in recording.topics} == {TOPIC: 1, "/other_traffic/no_time": 1}
        assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS)


# --- files


@pytest.mark.parametrize(
    "content", [pcap([])[:10], pcap([]) + b"\xff" * 40, section()[:20], section() + b"\xff" * 40], ids=str
)
def test_nothing_to_save(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"velodyne\.pcap: the file is damaged.*nothing in it can be recovered"):
        open_recording([written(tmp_path, content)])


def test_memory_does_not_hold_the_packets(tmp_path: Path) -> None:
    path = written(tmp_path, pcap(CAPTURE * 200))
    assert path.stat().st_size > 10_000_000
    with at_most(4), open_recording([path]) as recording:
        assert sum(1 for _ in recording.messages()) == 8_000


HEAD, TAIL = (Fragment((b"12345678", 7), 0, False, 0, 16), Fragment((b"12345678", 7), 16, True, 0, 8))


def test_fragments_are_put_together_in_any_order() -> None:
    for order in ((HEAD, TAIL), (TAIL, HEAD)):
        found = Reassembly()
        assert found.add(order[0], 100, bytes(16)) is None
        whole = found.add(order[1], 200, bytes(16))
        assert whole is not None
        assert sum(size for _, size in whole.pieces) == 16, "without UDP's header"
        assert found.close() == 0


def test_a_number_that_comes_again_is_of_another_packet() -> None:
    """The number of a packet has 16 bits; what was left of the first one is given up, and counted."""
    found = Reassembly()
    assert found.add(TAIL, 100, bytes(8)) is None
    assert found.add(HEAD, 100_000_000, bytes(16)) is None
    assert found.add(TAIL, 100_000_100, bytes(8)) is not None
    assert found.close() == 1
