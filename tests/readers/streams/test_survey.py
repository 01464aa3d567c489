"""Rates and gaps of topics."""

import numpy as np
import pytest
from builders import odometry, raw
from memory_recording import MemoryRecording

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.streams.survey import survey

SECOND_NS = 1_000_000_000
EVERY_100_MS = np.arange(50) * SECOND_NS // 10


def messages(stamps_ns: I64) -> list[RawMessage]:
    return [raw("/t", "nav_msgs/msg/Odometry", odometry(stamp_ns=int(t)), int(t)) for t in stamps_ns + SECOND_NS]


@pytest.mark.parametrize(
    ("stamps_ns", "rate_hz", "gaps"),
    [
        (EVERY_100_MS[:1], 0.0, 0),
        (EVERY_100_MS, 10.0, 0),
        (np.delete(EVERY_100_MS, [10, 30, 31]), 10.0, 1),  # one lost message is no gap, two are
        (np.delete(EVERY_100_MS, np.arange(20, 40)), 10.0, 1),
        # two senders, 1 ms after each other: 2 every 100 ms, and no gap
        (np.sort(np.concatenate([EVERY_100_MS, EVERY_100_MS + 1_000_000])), 20.0, 0),
    ],
    ids=["one", "even", "losses", "pause", "two senders"],
)
def test_rate_and_gaps(stamps_ns: I64, rate_hz: float, gaps: int) -> None:
    (topic,) = survey(MemoryRecording(messages(stamps_ns)))
    assert topic.rate_hz == pytest.approx(rate_hz, rel=0.02)
    assert topic.gaps == gaps
    assert topic.count == len(stamps_ns)


def test_of_a_part_only_the_count_is_of_all() -> None:
    every_s = np.arange(50) * SECOND_NS
    recording = MemoryRecording(messages(np.concatenate([EVERY_100_MS, EVERY_100_MS[-1] + every_s])))
    (topic,) = survey(recording, stop_ns=recording.start_ns + 4 * SECOND_NS)
    assert topic.count == 100
    assert [topic.rate_hz, topic.longest_gap_s] == pytest.approx([10, 0.1])


@pytest.mark.parametrize("wrong", [(2**64, 0), (-1, 0), (0, 2**64 - 1)])
def test_what_cannot_be_a_time_is_told_and_in_no_figure(wrong: tuple[int, int]) -> None:
    messages = [raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=i), i) for i in range(0, 10 * 10**9, 10**8)]
    messages[50] = messages[50]._replace(stamp_ns=wrong[0], log_time_ns=wrong[1])
    (found,) = survey(MemoryRecording(messages))
    assert found.count == 100
    assert found.rate_hz == pytest.approx(10)
    assert found.problem.startswith("1 stamps or log times cannot be times: ")


def test_times_of_no_more_messages_than_may_be_in_memory(caplog: pytest.LogCaptureFixture) -> None:
    recording = MemoryRecording(messages(np.arange(10) * 10**8))
    limits = RecordingLimits(max_messages_in_memory=4)
    (found,) = survey(recording, limits=limits)
    assert (found.count, round(found.rate_hz)) == (10, 10)
    assert caplog.messages == ["rates, gaps and delays are those of the first 4 messages: raise limit_scale"]
