import pytest
from builders import odometry, raw
from memory_recording import MemoryRecording

from pipeline.core.messages import RawMessage
from readers.recording import Recording


def state(topic: str, log_time_ns: int, stamp_ns: int) -> RawMessage:
    return raw(topic, "nav_msgs/msg/Odometry", odometry(stamp_ns=stamp_ns), stamp_ns, log_time_ns)


def test_messages_in_the_order_of_log_time_then_place() -> None:
    recording: Recording = MemoryRecording([state("/b", 9, 0), state("/a", 5, 1), state("/b", 5, 2), state("/b", 1, 3)])
    with recording:
        got = list(recording.messages())
    assert [(m.log_time_ns, m.stamp_ns, m.order) for m in got] == [
        (1, 3, (0, 3)),
        (5, 1, (0, 1)),
        (5, 2, (0, 2)),
        (9, 0, (0, 0)),
    ]
    assert [(t.topic, t.message_count) for t in recording.topics] == [("/a", 1), ("/b", 3)]
    assert (recording.start_ns, recording.end_ns, recording.message_count, recording.paths) == (1, 9, 4, ())


@pytest.mark.parametrize(
    ("topics", "start_ns", "stop_ns", "expected"),
    [
        (None, 5, None, [1, 2, 0]),
        (None, None, 5, [3]),
        (["/b"], 5, 9, [2]),
        (["/nothing"], None, None, []),
        ([], None, None, []),
    ],
)
def test_window_and_topics(
    topics: list[str] | None, start_ns: int | None, stop_ns: int | None, expected: list[int]
) -> None:
    recording = MemoryRecording([state("/b", 9, 0), state("/a", 5, 1), state("/b", 5, 2), state("/b", 1, 3)])
    got = recording.messages(topics, start_ns=start_ns, stop_ns=stop_ns)
    assert [m.stamp_ns for m in got] == expected


def test_empty() -> None:
    recording = MemoryRecording([])
    assert list(recording.messages()) == []
    assert (recording.start_ns, recording.end_ns, recording.message_count, recording.topics) == (0, 0, 0, ())
