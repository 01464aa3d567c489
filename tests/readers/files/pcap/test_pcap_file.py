import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from captures import capture_of, ethernet, interface, ip_packet, ng_packet, pcap, section
from velodyne import START_NS, random_packets

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

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
        ethernet(ip_packet(bytes(554), port=8308)),
        ethernet(ip_packet(bytes(554), port=8308)),
        ethernet(ip_packet(b"who is there", port=53)),
        ethernet(fragment),
        ethernet(b"who has", 0x0806),
        ethernet(ip_packet(PAYLOAD[0].tobytes()))[:900],
    ]
    path = written(tmp_path, pcap((START_NS + n, frame) for n, frame in enumerate(frames)))
    with open_recording([path]) as recording:
        found = {info.topic: (info.message_count, bool(info.unreadable)) for info in recording.topics}
        assert recording.message_count == 7
        assert len(list(recording.messages())) == 1
    assert found == {
        TOPIC: (1, False),
        "/other_traffic/cut_short": (1, True),
        "/other_traffic/fragments": (1, True),
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


def test_truncated(tmp_path: Path) -> None:
    path = written(tmp_path, pcap(CAPTURE)[:-100])
    with open_recording([path]) as recording:
        assert payloads(list(recording.messages())) == [data.tobytes() for data in PAYLOAD[:-1]]
        [loss] = recording.losses
        assert (loss.path, loss.messages) == (path, 1)
        assert loss.position + (loss.size or 0) == path.stat().st_size
        assert "a packet is cut off: expected 1248 bytes, found 1148" in loss.reason
    with pytest.raises(RecordingError, match=r"velodyne\.pcap: .*at byte \d+: a packet is cut off"):
        open_recording([path], ReadOptions("none"))


@pytest.mark.parametrize(
    "content", [pcap([])[:10], pcap([]) + b"\xff" * 40, section()[:20], section() + b"\xff" * 40], ids=str
)
def test_nothing_to_save(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"velodyne\.pcap: the file is damaged.*nothing in it can be recovered"):
        open_recording([written(tmp_path, content)])


def test_memory_does_not_hold_the_packets(tmp_path: Path) -> None:
    path = written(tmp_path, pcap(CAPTURE * 200))
    tracemalloc.start()
    with open_recording([path]) as recording:
        assert sum(1 for _ in recording.messages()) == 8_000
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert path.stat().st_size > 10_000_000
    assert most < 4_000_000
