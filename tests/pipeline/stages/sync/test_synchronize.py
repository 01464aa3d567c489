"""Messages to frames: what a frame is called and holds, what is counted, and when it comes."""

from collections import Counter
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.errors import ConfigError, RecordingError
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.core.settings.sync import SyncConfig
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.pipeline.stages.sync.synchronize import synchronize as synchronize_

MS = 1_000_000
CHANNELS = [Channel(f"/t{topic}", "sensor_msgs/msg/Image", "cdr") for topic in range(4)]


def message(topic: int, stamp_ms: int, position: int = 0, *, size: int = 0) -> RawMessage:
    return RawMessage(stamp_ms * MS, (stamp_ms + 7) * MS, (0, position), bytes(size), CHANNELS[topic])


DEFAULTS = SyncConfig()


def synchronize(
    messages: Iterable[RawMessage], config: SyncConfig = DEFAULTS
) -> tuple[list[SensorBundle], list[Drop], SyncStats]:
    drops: list[Drop] = []
    stats = SyncStats()
    bundles = synchronize_(messages, ["/t1", "/t0"], config, reference="/t0", on_drop=drops.append, stats=stats)
    return list(bundles), drops, stats


def frames(count: int) -> list[RawMessage]:
    return [message(topic, 100 * frame + 10 * topic, 4 * frame) for frame in range(count) for topic in range(3)]


def test_frames_have_the_reference_stamp_and_the_order_of_topics() -> None:
    bundles, drops, stats = synchronize(frames(3))
    assert [bundle.index for bundle in bundles] == [0, 1, 2]
    assert [bundle.stamp_ns for bundle in bundles] == [0, 100 * MS, 200 * MS]
    assert [bundle.log_time_ns for bundle in bundles] == [7 * MS, 107 * MS, 207 * MS]
    assert [list(bundle.messages) for bundle in bundles] == [["/t1", "/t0"]] * 3
    assert all(topic == m.topic for bundle in bundles for topic, m in bundle.messages.items())
    assert drops == []
    assert stats == SyncStats({"/t1": 3, "/t0": 3}, 3, 10 * MS, 30 * MS)
    assert stats.skew_mean_ns == 10 * MS


@pytest.mark.parametrize(("messages", "dropped"), [([], 0), ([message(0, 0)], 1), ([message(2, 0)], 0)])
def test_recordings_without_a_set(messages: list[RawMessage], dropped: int) -> None:
    bundles, drops, stats = synchronize(messages)
    assert bundles == []
    assert len(drops) == dropped
    assert stats.received == {"/t1": 0, "/t0": dropped}
    assert (stats.sets, stats.skew_mean_ns) == (0, 0.0)


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 40)), max_size=40))
def test_bundles_count_what_was_left_out_before_them(arrivals: list[tuple[int, int]]) -> None:
    messages = [message(topic, stamp_ms, position) for position, (topic, stamp_ms) in enumerate(arrivals)]
    drops: list[Drop] = []
    config = SyncConfig(queue_size=3, slop_s=0.005)
    told: Counter[tuple[str, str]] = Counter()
    for bundle in synchronize_(messages, ["/t0", "/t1"], config, reference="/t0", on_drop=drops.append):
        told.update(bundle.dropped_before)
        assert told == Counter((drop.topic, drop.reason) for drop in drops)


def test_max_interval_bounds_approximate_time() -> None:
    apart = [message(0, 0), message(1, 90)]
    assert len(synchronize(apart, SyncConfig(max_interval_s=0.09))[0]) == 1
    assert len(synchronize(apart, SyncConfig(max_interval_s=0.08))[0]) == 0
    assert len(synchronize([message(0, 0), message(1, 900)], SyncConfig(max_interval_s=None))[0]) == 1


@pytest.mark.parametrize(("topics", "fault"), [([], "found none"), (["/t0", "/t0"], "found /t0, /t0")])
def test_wrong_topics_are_refused_at_once(topics: list[str], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        synchronize_([], topics, SyncConfig(), reference="/t0", on_drop=print)


# --- messages that wait for one another hold a bounded amount of memory


def frames_of(messages: list[RawMessage], max_waiting_bytes: int | None) -> int:
    found = synchronize_(
        messages,
        ("/t0", "/t1"),
        SyncConfig(queue_size=5),
        reference="/t0",
        on_drop=lambda _: None,
        max_waiting_bytes=max_waiting_bytes,
    )
    return len(list(found))


def test_what_came_together_or_was_dropped_waits_no_longer() -> None:
    together = [message(topic, 100 * i, size=1000) for i in range(50) for topic in (0, 1)]
    assert frames_of(together, 6000) == 50
    assert frames_of([message(0, 100 * i, size=1000) for i in range(50)], 7000) == 0  # a queue of five


def test_more_than_may_wait() -> None:
    alone = [message(0, 100 * i, size=1 << 20) for i in range(5)]
    assert frames_of(alone, None) == 0
    with pytest.raises(RecordingError, match=r"/t0: messages of more than 3 MiB wait .* raise limit_scale"):
        frames_of(alone, 3 << 20)
