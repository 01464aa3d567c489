from collections.abc import Iterable, Sequence
from dataclasses import replace

import builders
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_recording import MemoryRecording
from velodyne import START_NS, packet_stream, random_packets

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.readers.sweeps import PAUSE_NS, gather_sweeps
from lidcam.readers.velodyne import sweeps as velodyne_sweeps
from lidcam.readers.velodyne.scan import SCAN, parse_velodyne_scan

TOPIC = "/velodyne_packets"
MS = 1_000_000


def gathered(messages: Iterable[RawMessage], topics: Sequence[str] | None = None, **window: int) -> list[RawMessage]:
    return list(sensor_messages(MemoryRecording(messages)).messages(topics, **window))


def stream(azimuths: Sequence[int], clock_us: Sequence[int] | None = None, topic: str = TOPIC) -> list[RawMessage]:
    """Packets that begin at the given azimuths, a millisecond apart; the last byte counts them."""
    payload = np.zeros((len(azimuths), 1206), np.uint8)
    payload[:, :2] = 0xFF, 0xEE
    payload[:, 2:4] = np.array(azimuths, "<u2")[:, None].view(np.uint8)
    clock = np.arange(len(azimuths)) * 1000 if clock_us is None else np.array(clock_us)
    payload[:, 1200:1204] = clock.astype("<u4")[:, None].view(np.uint8)
    payload[:, 1205] = np.arange(len(azimuths))
    return packet_stream(payload, START_NS + np.arange(len(azimuths)) * MS, topic=topic)


def numbers(sweeps: Iterable[RawMessage]) -> list[list[int]]:
    return [parse_velodyne_scan(sweep).payload[:, 1205].tolist() for sweep in sweeps]


# --- where sweeps are cut


@pytest.mark.parametrize(
    ("azimuths", "sweeps"),
    [
        ([], []),
        ([100], [[0]]),
        ([100, 12_000, 24_000, 35_900, 11_000, 23_000], [[0, 1, 2, 3], [4, 5]]),
        ([34_000, 35_900, 100, 35_999, 0], [[0, 1], [2, 3, 4]]),  # the fourth packet was overtaken
        ([34_000, 35_900, 10, 35_990, 20, 18_000, 35_000, 900], [[0, 1], [2, 3, 4, 5, 6], [7]]),
        ([5, 35_990, 10, 18_000, 100], [[0, 1, 2, 3], [4]]),
        ([35_999, 0, 35_999, 1], [[0], [1, 2, 3]]),
        ([0, 18_000, 0, 18_000, 0], [[0, 1], [2, 3], [4]]),
        ([7, 7, 7], [[0, 1, 2]]),
        ([30_000, 40_000, 31_000, 100], [[0, 1, 2], [3]]),  # an azimuth that cannot be
    ],
)
def test_cut_where_the_head_passes_zero(azimuths: list[int], sweeps: list[list[int]]) -> None:
    assert numbers(gathered(stream(azimuths))) == sweeps


@pytest.mark.parametrize(
    ("azimuths", "clock_ms", "sweeps"),
    [
        ([0, 360, 18_360, 0, 360], [0, 1, 51, 100, 101], [[0, 1, 2], [3, 4]]),  # packets of half a turn were lost
        ([0, 360, 720, 1080], [0, 1, 102, 103], [[0, 1], [2, 3]]),  # those of a whole turn
        ([27_000, 0, 9_000, 27_000, 0, 9_000], [0, 25, 50, 100, 125, 150], [[0], [1, 2, 3], [4, 5]]),  # half is seen
        ([35_000, 0, 500, 35_000, 0], [0, 2, 4, 97, 100], [[0], [1, 2, 3], [4]]),  # or less
        ([100, 200, 300], [0, 51, 52], [[0], [1, 2]]),  # no speed is known
        ([100, 200, 300, 400], [0, 1, -60, -59], [[0, 1], [2, 3]]),  # the clock was set
    ],
)
def test_the_head_turns_on_where_packets_are_missing(
    azimuths: list[int], clock_ms: list[int], sweeps: list[list[int]]
) -> None:
    assert numbers(gathered(stream(azimuths, [(60 + ms) * 1000 for ms in clock_ms]))) == sweeps


def test_the_hour_of_the_sensors_clock_turns() -> None:
    clock_us = [3_599_999_000, 3_599_999_900, 800, 1_700]
    assert numbers(gathered(stream([100, 200, 300, 400], clock_us))) == [[0, 1, 2, 3]]


def test_cut_where_nothing_was_recorded() -> None:
    messages = stream([100, 200, 300, 400])
    late = [m._replace(log_time_ns=m.log_time_ns + PAUSE_NS - MS) for m in messages[2:]]
    assert numbers(gathered([*messages[:2], *late])) == [[0, 1], [2, 3]]
    late = [m._replace(log_time_ns=m.log_time_ns + PAUSE_NS - 2 * MS) for m in messages[2:]]
    assert numbers(gathered([*messages[:2], *late])) == [[0, 1, 2, 3]]


def test_a_sweep_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(velodyne_sweeps, "MAX_PACKETS", 3)
    assert numbers(gathered(stream([7] * 7))) == [[0, 1, 2], [3, 4, 5], [6]]


# --- what a sweep is


def test_stamp_of_the_first_packet_and_log_time_of_the_last() -> None:
    messages = stream([100, 200, 300])
    messages = [m._replace(log_time_ns=m.log_time_ns + 7 * MS) for m in messages]
    [sweep] = gathered(messages)
    assert sweep.stamp_ns == START_NS
    assert (sweep.log_time_ns, sweep.order) == (START_NS + 9 * MS, (0, 2))
    assert sweep.channel.msgtype == SCAN
    fields = deserialize(sweep)
    assert (fields.header.frame_id, len(fields.packets)) == ("", 3)
    assert fields.header.stamp == fields.packets[0].stamp
    assert [p.data[1205] for p in fields.packets] == [0, 1, 2]


@pytest.mark.parametrize("definitions", [True, False])
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_ros1_and_ros2_with_or_without_definition(encoding: builders.Encoding, definitions: bool) -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=5, start=0)
    messages = packet_stream(payload, stamps_ns, encoding=encoding)
    if not definitions:
        messages = [m._replace(channel=replace(m.channel, definition="")) for m in messages]
    [sweep] = gathered(messages)
    packets = parse_velodyne_scan(sweep)
    np.testing.assert_array_equal(packets.payload, payload)
    np.testing.assert_array_equal(packets.stamps_ns, stamps_ns)


# --- what cannot be used


def test_packets_that_cannot_be_used_are_told_of() -> None:
    messages = stream([100, 200, 300, 18_000, 100, 200])
    messages[1] = messages[1]._replace(data=messages[1].data[:900])
    messages[4] = messages[4]._replace(data=b"", problem="lost")
    sweeps = gathered(messages)
    assert numbers(sweeps) == [[0, 2, 3], [5]]
    assert [len(sweep.defects) for sweep in sweeps] == [2, 0]
    assert "expected a velodyne_msgs/msg/VelodynePacket of 1218 bytes, found 900 bytes" in sweeps[0].defects[0]
    assert sweeps[0].defects[1] == f"{TOPIC}: lost"
    (none,) = gathered([message._replace(data=b"short") for message in messages[:3]])
    assert none.problem.startswith("none of 3 packets can be used; the first: ")


# --- beside other messages


def test_another_definition_is_refused() -> None:
    channel = replace(stream([1])[0].channel, definition="builtin_interfaces/Time stamp\nuint8[1248] data")
    recording = sensor_messages(MemoryRecording([m._replace(channel=channel) for m in stream([1, 2])]))
    [info] = recording.topics
    assert "its definition of velodyne_msgs/msg/VelodynePacket is not a stamp and uint8[1206]" in info.unreadable
    assert (info.msgtype, info.message_count, info.channels) == (SCAN, 2, ())
    assert list(recording.messages()) == []


def other(at_ns: int, topic: str = "/other") -> RawMessage:
    channel = Channel(topic, "std_msgs/msg/Empty", "cdr")
    return RawMessage(at_ns, at_ns, (0, 0), b"", channel)


def test_messages_wait_for_open_sweeps_only() -> None:
    """Nothing is read further than needed: a lidar that falls silent does not hold up the others."""
    taken = 0

    def counted() -> Iterable[RawMessage]:
        nonlocal taken
        silent = [other(START_NS + n * 100 * MS) for n in range(1, 100)]
        for order, message in enumerate([*stream([100]), *silent]):
            taken += 1
            yield message._replace(order=(0, order))

    channels = {stream([100])[0].channel: velodyne_sweeps.VelodyneSweep}
    sweeps = gather_sweeps(counted(), channels, start_ns=None, stop_ns=None)
    assert next(sweeps).topic == TOPIC
    assert taken == 6
    assert [next(sweeps).log_time_ns - START_NS for _ in range(3)] == [100 * MS, 200 * MS, 300 * MS]
    assert taken == 6


@given(st.data())
def test_any_stream_keeps_every_packet_and_message_in_order(data: st.DataObject) -> None:
    azimuths = data.draw(st.lists(st.integers(0, 36_100), max_size=40))
    steps_ms = data.draw(st.lists(st.sampled_from([0, 1, 3, 30, 499, 501]), min_size=60, max_size=60))
    times_ns = START_NS + np.cumsum(steps_ms) * MS
    messages: list[RawMessage] = []
    for packet, at_ns in zip(stream(azimuths, [0] * len(azimuths)), times_ns.tolist(), strict=False):
        messages.append(packet._replace(log_time_ns=at_ns))
        if data.draw(st.booleans()):
            messages.append(other(at_ns))
    found = gathered(messages)
    assert [(m.log_time_ns, m.order) for m in found] == sorted((m.log_time_ns, m.order) for m in found)
    assert sum(m.topic == "/other" for m in found) == sum(m.topic == "/other" for m in messages)
    assert [n for sweep in numbers(m for m in found if m.topic == TOPIC) for n in sweep] == [*range(len(azimuths))]
    stop_ns = data.draw(st.sampled_from(times_ns.tolist()))
    assert gathered(messages, stop_ns=stop_ns) == [m for m in found if m.log_time_ns < stop_ns]


def test_a_window_holds_whole_sweeps() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=600, start=0)
    messages = packet_stream(payload, stamps_ns)
    found = gathered(messages)
    assert len(found) == 8
    for first in range(8):
        for last in range(first, 8):
            start_ns, stop_ns = found[first].log_time_ns, found[last].log_time_ns
            assert gathered(messages, start_ns=start_ns, stop_ns=stop_ns + 1) == found[first : last + 1]
            assert gathered(messages, start_ns=start_ns + 1, stop_ns=stop_ns) == found[first + 1 : last]
