"""Messages that wait for one another hold a bounded amount of memory."""

import pytest

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.core.settings.sync import SyncConfig
from lidcam.pipeline.stages.sync.synchronize import synchronize


def message(topic: str, stamp_ms: int, size: int) -> RawMessage:
    channel = Channel(topic, "a/msg/A", "cdr", "", "ros2msg")
    return RawMessage(stamp_ms * 10**6, stamp_ms * 10**6, (0, stamp_ms), bytes(size), channel)


def run(messages: list[RawMessage], max_waiting_bytes: int | None) -> int:
    drops: list[Drop] = []
    found = synchronize(
        messages,
        ("/a", "/b"),
        SyncConfig(queue_size=5),
        reference="/a",
        on_drop=drops.append,
        max_waiting_bytes=max_waiting_bytes,
    )
    return len(list(found))


def test_what_came_together_or_was_dropped_waits_no_longer() -> None:
    together = [message(topic, 100 * i, 1000) for i in range(50) for topic in ("/a", "/b")]
    assert run(together, 6000) == 50
    alone = [message("/a", 100 * i, 1000) for i in range(50)]
    assert run(alone, 7000) == 0  # a queue of five


def test_more_than_may_wait() -> None:
    alone = [message("/a", 100 * i, 1 << 20) for i in range(5)]
    assert run(alone, None) == 0
    with pytest.raises(RecordingError, match=r"/a: messages of more than 3 MiB wait .* raise limit_scale"):
        run(alone, 3 << 20)
