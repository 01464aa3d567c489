"""Frames go on without the sensors that are silent: which frames there are, and what is said of those that lack one."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import pytest

from lidcam.pipeline.core.frame import Missing, SensorBundle
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.core.settings.sync import SyncConfig
from lidcam.pipeline.stages.sync.drop_reason import DropReason
from lidcam.pipeline.stages.sync.synchronize import SyncStats, synchronize

MS = 1_000_000
LIDARS = ("/lidar0", "/lidar1", "/lidar2")
CAMERAS = tuple(f"/cam{number}" for number in range(8))
TOPICS = LIDARS + CAMERAS
CHANNELS = {topic: Channel(topic, "sensor_msgs/msg/Image", "cdr") for topic in TOPICS}

Taken = Callable[[float], bool]  # whether a message of this stamp, in seconds, was recorded


def always(_stamp_s: float) -> bool:
    return True


def until(end_s: float) -> Taken:
    return lambda stamp_s: stamp_s <= end_s


def since(start_s: float) -> Taken:
    return lambda stamp_s: stamp_s >= start_s


def apart_from(start_s: float, end_s: float) -> Taken:
    return lambda stamp_s: stamp_s <= start_s or stamp_s >= end_s


def recorded(
    taken: Mapping[str, Taken],
    *,
    length_s: float = 3,
    period_ms: Mapping[str, int] | None = None,
    latency_ms: Mapping[str, int] | None = None,
) -> list[RawMessage]:
    """Sensors of 10 Hz, a few milliseconds apart; lidars are recorded 50 ms after their stamp, cameras 20 ms."""
    messages: list[RawMessage] = []
    for number, topic in enumerate(TOPICS):
        latency = (latency_ms or {}).get(topic, 20 if topic in CAMERAS else 50)
        for stamp_ms in range(number % 7, round(length_s * 1000), (period_ms or {}).get(topic, 100)):
            log_ms = stamp_ms + latency
            if taken.get(topic, always)(stamp_ms / 1000) and log_ms < 1000 * length_s + 50:
                messages.append(message(topic, stamp_ms, log_ms, len(messages)))
    return sorted(messages, key=lambda m: (m.log_time_ns, m.order))


def message(topic: str, stamp_ms: int, log_ms: int, position: int = 0) -> RawMessage:
    return RawMessage(stamp_ms * MS, log_ms * MS, (0, position), b"", CHANNELS[topic])


def run(
    messages: Iterable[RawMessage], *, topics: Sequence[str] = TOPICS
) -> tuple[list[SensorBundle], Counter[tuple[str, str]], SyncStats]:
    drops: Counter[tuple[str, str]] = Counter()

    def on_drop(drop: Drop) -> None:
        drops[drop.topic, drop.reason] += 1

    stats = SyncStats()
    found = synchronize(
        messages, topics, SyncConfig(), reference=LIDARS[0], required=LIDARS, on_drop=on_drop, stats=stats
    )
    return list(found), drops, stats


Absences = dict[str, tuple[int, list[tuple[float | None, float | None]]]]


def said(stats: SyncStats) -> Absences:
    """Frames without, and spans of silence in seconds rounded to tenths, by topic."""

    def seconds(log_time_ns: int | None) -> float | None:
        return None if log_time_ns is None else round(log_time_ns / 1e9, 1)

    return {
        absence.topic: (absence.frames, [(seconds(s.start_ns), seconds(s.end_ns)) for s in absence.silences])
        for absence in stats.attendance.absences(TOPICS)
    }


@pytest.mark.parametrize(
    ("name", "messages", "frames", "expected"),
    [
        ("all well", recorded({}), 30, {}),
        ("a camera dies", recorded({"/cam0": until(1)}), 30, {"/cam0": (20, [(0.9, None)])}),
        ("a camera begins late", recorded({"/cam0": since(1)}), 30, {"/cam0": (10, [(None, 1.0)])}),
        ("a camera at half the rate", recorded({}, period_ms={"/cam0": 200}), 30, {"/cam0": (15, [])}),
        ("a camera pauses", recorded({"/cam0": apart_from(1, 4)}, length_s=6), 60, {"/cam0": (30, [(0.9, 4.0)])}),
        ("a camera at 1 Hz", recorded({}, period_ms={"/cam0": 1000}), 30, {"/cam0": (27, [])}),
        ("a lidar dies", recorded({"/lidar1": until(1)}), 30, {"/lidar1": (20, [(1.0, None)])}),
        ("the reference dies", recorded({"/lidar0": until(1)}), 30, {"/lidar0": (19, [(1.1, None)])}),
        ("the reference pauses", recorded({"/lidar0": apart_from(1, 2)}), 30, {"/lidar0": (9, [(1.1, 2.0)])}),
        ("a lidar begins late", recorded({"/lidar1": since(1)}), 30, {"/lidar1": (10, [(None, 1.1)])}),
        ("all at half rate", recorded({}, period_ms=dict.fromkeys(CAMERAS, 200)), 30, dict.fromkeys(CAMERAS, (15, []))),
        ("all pause", recorded(dict.fromkeys(TOPICS, apart_from(0.95, 11)), length_s=12), 20, {}),
        ("a lidar is silent at the end", recorded({"/lidar1": until(2.6)}), 30, {"/lidar1": (4, [(2.6, None)])}),
    ],
)
def test_every_frame_counts(name: str, messages: list[RawMessage], frames: int, expected: Absences) -> None:
    bundles, drops, stats = run(messages)
    assert len(bundles) == frames, name
    assert said(stats) == expected
    assert not drops
    assert [bundle.index for bundle in bundles] == [*range(frames)]
    for bundle in bundles:
        assert {*bundle.messages} | {*bundle.missing} == {*TOPICS}
        assert [*bundle.messages] == [topic for topic in TOPICS if topic in bundle.messages]


@pytest.mark.parametrize("alive", ["/lidar1", "/cam5"])
def test_one_sensor_left_makes_frames_of_its_own(alive: str) -> None:
    taken = {topic: until(1) for topic in TOPICS if topic != alive}
    bundles, drops, stats = run(recorded(taken))
    assert len(bundles) == 30
    assert not drops
    assert alive not in said(stats)
    assert all([*bundle.messages] == [alive] for bundle in bundles[12:])
    assert all(set(bundle.missing.values()) == {Missing.SILENT} for bundle in bundles[12:])
    assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(bundles))


def test_the_next_lidar_is_the_reference_then_a_camera_until_the_first_is_back() -> None:
    taken = {"/lidar0": until(1), "/lidar1": until(2), "/lidar2": apart_from(2, 3)}
    bundles, _, _ = run(recorded(taken, length_s=4))
    references = [next(t for t, m in b.messages.items() if m.stamp_ns == b.stamp_ns) for b in bundles]
    assert list(dict.fromkeys(references)) == ["/lidar0", "/lidar1", "/cam0", "/lidar2"]
    assert len(bundles) == 40


def test_what_a_frame_lacks_is_is_told_by_reason() -> None:
    messages = recorded({"/cam0": until(1), "/cam1": lambda stamp_s: not 1.45 < stamp_s < 1.55})
    bundles, _, _ = run(messages)
    assert bundles[5].missing == {}
    assert bundles[15].missing == {"/cam0": Missing.SILENT, "/cam1": Missing.NOT_NEAR}
    assert bundles[16].missing == {"/cam0": Missing.SILENT}


def test_a_required_topic_that_lost_one_message_costs_that_frame() -> None:
    bundles, drops, stats = run(recorded({"/lidar1": lambda stamp_s: not 1.45 < stamp_s < 1.55}))
    assert len(bundles) == 29
    assert sum(count for (topic, _), count in drops.items() if topic == "/lidar0") == 1
    assert not said(stats)


def test_a_latency_beyond_the_queue_costs_that_sensor_and_no_frame() -> None:
    messages = recorded({}, length_s=6, latency_ms={"/lidar1": 2000, "/cam0": 2000})
    bundles, drops, _ = run(messages)
    assert len(bundles) == 60
    assert all("/lidar0" in bundle.messages for bundle in bundles)
    assert drops["/lidar1", DropReason.TOO_LATE] > 30
    assert drops["/cam0", DropReason.TOO_LATE] > 30
    assert "sync.queue_size" in DropReason.TOO_LATE


def test_a_fast_lidar_beside_one_that_has_not_begun_keeps_its_frames() -> None:
    messages = recorded({"/lidar1": since(0.3)}, period_ms={"/lidar0": 10, "/lidar2": 10})
    bundles, _, _ = run(messages, topics=LIDARS)
    assert len([b for b in bundles if b.stamp_ns < 300 * MS]) >= 29  # every sweep before it begins
    assert all("/lidar1" in b.messages for b in bundles if 500 * MS < b.stamp_ns < 2900 * MS)


def test_the_last_incomplete_turn_is_no_frame() -> None:
    messages = recorded({"/lidar1": until(2.85), "/lidar2": until(2.85)})
    bundles, drops, _ = run(messages)
    assert len(bundles) == 29
    assert drops["/lidar0", DropReason.END] == 1


def test_memory_is_bounded_however_many_are_waited_for() -> None:
    """Messages that neither came out nor were dropped, at any time."""
    messages = recorded({"/lidar1": until(0.2), "/cam0": until(0.2)}, length_s=5, latency_ms={"/cam1": 3000})
    held: Counter[str] = Counter()
    worst: Counter[str] = Counter()

    def arriving() -> Iterable[RawMessage]:
        for m in messages:
            held[m.topic] += 1
            worst[m.topic] = max(worst[m.topic], held[m.topic])
            yield m

    def on_drop(drop: Drop) -> None:
        held[drop.topic] -= 1

    config = SyncConfig(queue_size=5)
    found = synchronize(arriving(), TOPICS, config, reference="/lidar0", required=LIDARS, on_drop=on_drop)
    for bundle in found:
        held.subtract([*bundle.messages])
    assert not +held
    assert max(worst.values()) <= 4 * 5 + 1
