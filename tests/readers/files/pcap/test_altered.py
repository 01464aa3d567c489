"""Captures in which an address or a time was altered."""

from pathlib import Path

import pytest
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
