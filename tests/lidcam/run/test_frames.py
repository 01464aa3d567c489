from collections import deque
from dataclasses import replace
from itertools import accumulate, count
from typing import Literal

import pytest
from memory_recording import MemoryRecording
from small_drive import STEP_NS, small_drive

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.stages.sync.clocks import Clocks
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.streams.motion import find_motion_source
from lidcam.run.frames import SAME_CLOUD, SAME_IMAGE, RunInput, _every, bundles, sensor_clocks, synchronize_stamps
from lidcam.run.tally import DropTable


def test_frames_that_are_left_out_hand_their_drops_on() -> None:
    bundles = [SensorBundle(number, number, number, {}, dropped_before={("/a", "late"): 1}) for number in range(7)]
    found = [*_every(bundles, 3, count(), DropTable("skip"))]
    assert [(one.index, one.stamp_ns) for one in found] == [(0, 0), (1, 3), (2, 6)]
    assert [one.dropped_before for one in found] == [{("/a", "late"): drops} for drops in (1, 3, 3)]


@pytest.mark.parametrize(
    ("delay_ms", "max_bytes", "known"),
    [(1, 1 << 20, 30), (150, 1 << 20, 30), (900, 1 << 20, 30), (900, 1, 2), (3000, 1 << 20, 11)],  # the last second
)
def test_frames_wait_for_odometry_that_is_recorded_late(
    delay_ms: int, max_bytes: int, known: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidcam.run.frames.MAX_MOTION_BYTES", max_bytes)
    late_ns = (delay_ms - 1) * 1_000_000
    messages = [
        one._replace(log_time_ns=one.log_time_ns + late_ns * (one.topic == "/odom")) for one in small_drive(frames=30)
    ]
    covered = [
        bundle.motion is not None and bundle.motion.covers(bundle.stamp_ns, bundle.stamp_ns + STEP_NS)
        for bundle in bundles(*run_of(messages))
    ]
    assert sum(covered) == known


def run_of(messages: list[RawMessage]) -> tuple[RunInput, DropTable, SyncStats, Clocks]:
    recording, config = MemoryRecording(sorted(messages, key=lambda one: one.log_time_ns)), Config()
    found = discover_rig(recording, config)
    motion, drops = find_motion_source(recording, found.rig, found.transforms, config), DropTable("skip")
    source = RunInput(recording, found.rig, config, motion)
    return source, drops, SyncStats(), sensor_clocks(found.rig, motion, drops)


@pytest.mark.parametrize("by_stamps", [False, True])
@pytest.mark.parametrize("late_ms", [0, 3, 40])
def test_messages_that_were_recorded_twice_count_once(late_ms: int, by_stamps: bool) -> None:
    once = small_drive(frames=30)
    again = [one._replace(log_time_ns=one.log_time_ns + late_ms * 1_000_000, order=(1, *one.order)) for one in once]
    source, drops, stats, clocks = run_of(once + again)
    if by_stamps:
        synchronize_stamps(source, drops, stats, clocks, source.recording.messages())
    else:
        deque(bundles(source, drops, stats, clocks), maxlen=0)
    assert stats.sets == 30
    assert [(row.topic, row.reason, row.count) for row in drops.rows] == [
        (topic, "recorded twice", 30) for topic in ("/cam/image_raw", "/points")
    ]


def hung(messages: list[RawMessage], topic: str) -> list[RawMessage]:
    """From the eleventh message of a topic on, all have its content behind their stamps."""
    content = bytes([one.data for one in messages if one.topic == topic][10])[12:]
    return [
        one._replace(data=bytes(one.data[:12]) + content) if one.topic == topic and number > 10 else one
        for number, one in zip(accumulate(one.topic == topic for one in messages), messages, strict=True)
    ]


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("method", "used"), [("callable", 11), ("none", 30)], ids=["detected", "copied"])
def test_a_picture_that_a_driver_repeats_with_new_stamps_goes_to_the_detector_once(
    method: Literal["callable", "none"], used: int, encoding: Literal["ros1", "cdr"]
) -> None:
    topic = "/cam/image_raw"
    source, drops, stats, clocks = run_of(hung(small_drive(encoding, frames=30), topic))
    config = Config(detect2d=Detect2DConfig(method=method))
    found = [*bundles(replace(source, config=config), drops, stats, clocks)]
    assert len(found) == 30
    assert sum(topic in bundle.messages for bundle in found) == used
    assert [row.count for row in drops.rows if row.reason == SAME_IMAGE] == [30 - used] * (used < 30)


@pytest.mark.parametrize(("motion", "used"), [("odometry", 11), ("tf", 11), ("none", 30)])
def test_a_cloud_that_a_driver_repeats_with_new_stamps_is_used_once_if_the_rig_moves(
    motion: Literal["odometry", "tf", "none"], used: int
) -> None:
    source, drops, stats, clocks = run_of(hung(small_drive("cdr", frames=30, motion=motion), "/points"))
    found = [*bundles(source, drops, stats, clocks)]
    assert sum("/points" in bundle.messages for bundle in found) == used
    assert [row.count for row in drops.rows if row.reason == SAME_CLOUD] == [30 - used] * (used < 30)
