from itertools import count

import pytest
from memory_recording import MemoryRecording
from small_drive import STEP_NS, small_drive

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.streams.motion import find_motion_source
from lidcam.run.frames import RunInput, _every, bundles, sensor_clocks
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
    recording, config = MemoryRecording(sorted(messages, key=lambda one: one.log_time_ns)), Config()
    found = discover_rig(recording, config)
    motion, drops = find_motion_source(recording, found.rig, found.transforms, config), DropTable("skip")
    source, clocks = RunInput(recording, found.rig, config, motion), sensor_clocks(found.rig, motion, drops)
    covered = [
        bundle.motion is not None and bundle.motion.covers(bundle.stamp_ns, bundle.stamp_ns + STEP_NS)
        for bundle in bundles(source, drops, SyncStats(), clocks)
    ]
    assert sum(covered) == known
