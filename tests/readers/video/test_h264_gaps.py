"""Packets of H.264 that are missing: noticed with every kind of stream that x264 makes, and none where none is."""

import pytest
from video import T0, Packet, compressed_video, encode, moving

from lidcam.readers.video.h264_gaps import GapFinder
from lidcam.readers.video.packets import read_packet

COUNT = 40
STREAMS = {
    "plain": {},
    "baseline": {"profile": "baseline"},
    "main": {"profile": "main"},
    "slices": {"slices": "4"},
    "sliced threads": {"x264_params": "slice-max-size=200"},
    "B-frames": {"bf": "3", "b_adapt": "0", "tune": "psnr"},
    "B-frames that others refer to": {"bf": "3", "b_adapt": "0", "tune": "psnr", "x264_params": "b-pyramid=normal"},
    "refresh image by image": {"intra_refresh": "1"},
    "open groups": {"x264_params": "open-gop=1:bframes=2", "tune": "psnr"},
    "many references": {"refs": "8", "tune": "psnr", "bf": "0"},
}


def gaps(packets: list[Packet]) -> list[int]:
    """Places of the packets before which one is missing."""
    finder = GapFinder()
    read = [read_packet(compressed_video(packet.data, T0)) for packet in packets]
    found = [finder.gap_before(packet.data.data, is_key=packet.is_key) for packet in read]
    assert all("is missing, or" in gap for gap in found if gap)
    return [place for place, gap in enumerate(found) if gap]


@pytest.mark.parametrize("name", STREAMS)
def test_nothing_is_missing(name: str) -> None:
    assert gaps(encode(moving(COUNT), gop=25, **STREAMS[name])) == []


@pytest.mark.parametrize("name", ["plain", "baseline", "main", "slices", "many references", "refresh image by image"])
@pytest.mark.parametrize("missing", [1, 16])
def test_one_is_missing(name: str, missing: int) -> None:
    packets = encode(moving(COUNT), gop=25, **STREAMS[name])
    assert gaps([*packets[:missing], *packets[missing + 1 :]]) == [missing]


@pytest.mark.parametrize("missing", [1, 24])
def test_a_key_frame_ends_the_count(missing: int) -> None:
    packets = encode(moving(COUNT), gop=25)
    assert gaps([*packets[:missing], *packets[25:]]) == []
