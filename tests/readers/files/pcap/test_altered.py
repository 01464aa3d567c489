"""Captures in which an address or a time was altered."""

import struct
from pathlib import Path

import pytest
from captures import block
from sound_recordings import read_all, sound_recording, write_files

from readers.open import open_recording

SOUND = sound_recording("pcap")
HEADER, PACKET = 24, 16 + 14 + 20 + 8 + 1206


def altered(tmp_path: Path, *places: tuple[int, int]) -> Path:
    content = bytearray(SOUND.files["rec.pcap"])
    for place, mask in places:
        content[place] ^= mask
    return write_files(tmp_path, SOUND, {"rec.pcap": bytes(content)})


def test_an_altered_address_makes_no_lidar(tmp_path: Path) -> None:
    path = altered(tmp_path, (HEADER + 3 * PACKET + 16 + 14 + 15, 0x10))
    with open_recording([path]) as recording:
        topics = {info.topic: info.message_count for info in recording.topics}
        assert len(list(recording.messages())) == recording.message_count - 1
    assert topics["/other_traffic/wrong_checksum"] == 1
    assert sum(topics.values()) == len(SOUND.messages)
    assert {*topics} - {"/other_traffic/wrong_checksum"} == {message.name[0] for message in SOUND.messages}


def test_senders_whose_checksums_are_all_wrong_are_read(tmp_path: Path) -> None:
    """As simulators and exporters write them."""
    places = [(HEADER + number * PACKET + 16 + 14 + 10, 0x55) for number in range(len(SOUND.messages))]
    messages, losses = read_all(altered(tmp_path, *places), "as_needed")
    assert (messages, losses) == (SOUND.messages, ())


@pytest.mark.parametrize("place", [2, 3])
def test_an_altered_time_is_told(tmp_path: Path, place: int) -> None:
    messages, (loss,) = read_all(altered(tmp_path, (HEADER + 6 * PACKET + place, 1)), "as_needed")
    assert len(messages) == len(SOUND.messages) - 1
    assert "another time of capture" in loss.reason
    assert loss.messages == 1


def test_a_clock_that_is_set_is_no_damage(tmp_path: Path) -> None:
    places = [(HEADER + number * PACKET + 3, 1) for number in range(10, len(SOUND.messages))]
    messages, losses = read_all(altered(tmp_path, *places), "as_needed")
    assert len(messages) == len(SOUND.messages)
    assert not losses


@pytest.mark.parametrize("mask", [1, 2, 0x10])
def test_a_packet_in_a_block_of_another_type_is_told(tmp_path: Path, mask: int) -> None:
    sound = sound_recording("pcapng")
    content = bytearray(sound.files["rec.pcapng"])
    start = content.index(b"\x06\0\0\0", 48)
    content[start] ^= mask
    messages, (loss,) = read_all(write_files(tmp_path, sound, {"rec.pcapng": bytes(content)}), "as_needed")
    assert len(messages) == len(sound.messages) - 1
    assert (loss.position, loss.messages) == (start, 1)


def test_other_blocks_are_passed_over(tmp_path: Path) -> None:
    sound = sound_recording("pcapng")
    names = block(4, struct.pack("<HH", 1, 8) + b"\x7f\0\0\1a.b\0" + bytes(4))
    custom = block(0xBAD, struct.pack("<I", 32473) + bytes(60))
    content = sound.files["rec.pcapng"] + names + custom + block(0x80000001, bytes(40)) + block(5, bytes(12))
    messages, losses = read_all(write_files(tmp_path, sound, {"rec.pcapng": content}), "as_needed")
    assert (messages, losses) == (sound.messages, ())
