"""A disk slower than the stages: what waits for it is bounded, however long the recording is."""

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Condition, Event, current_thread
from typing import ClassVar
from weakref import WeakSet

import numpy as np
import pytest
from builders import camera_info, image, raw, write_mcap
from small_drive import CAMERA_K, START_NS, STEP_NS, small_drive

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.parallel.background import Background
from lidcam.processing import RunObserver, process_recording
from lidcam.run.frames import bundles
from lidcam.run.job import make_job
from lidcam.run.tally import RunProgress
from lidcam.writers.mcap.chunk import Chunk
from lidcam.writers.mcap.output import CHUNK_BYTES

FRAMES = 16
IMAGE_PX = 480, 640, 3
FRAME_BYTES = 480 * 640 * 3
WAITING_BYTES = 4 << 20

READ_AHEAD = 2
"""Frames that wait for the poses around them, and for messages to copy."""


def drive() -> Iterator[RawMessage]:
    """A small drive with images of a megabyte."""
    messages = small_drive("cdr", frames=FRAMES, kinds=())
    messages = [message for message in messages if message.topic != "/cam/camera_info"]
    for number in range(FRAMES):
        at_ns = START_NS + number * STEP_NS
        info = camera_info(CAMERA_K, stamp_ns=at_ns, width_px=IMAGE_PX[1], height_px=IMAGE_PX[0], frame_id="cam")
        shot = image(np.full(IMAGE_PX, number, np.uint8), stamp_ns=at_ns, frame_id="cam")
        messages.append(raw("/cam/camera_info", "sensor_msgs/msg/CameraInfo", info, at_ns, at_ns + 2_000_000, "cdr"))
        messages.append(raw("/cam/image_raw", "sensor_msgs/msg/Image", shot, at_ns, at_ns + 8_000_000, "cdr"))
    return iter(sorted(messages, key=lambda message: message.log_time_ns))


class CountedChunk(Chunk):
    there: ClassVar["WeakSet[CountedChunk]"] = WeakSet()

    def __init__(self) -> None:
        super().__init__()
        self.there.add(self)


class Told(Condition):
    """Tells when a thread other than that of the disk waits."""

    def __init__(self, is_waited_for: Event) -> None:
        super().__init__()
        self._is_waited_for = is_waited_for

    def wait(self, timeout: float | None = None) -> bool:
        if current_thread().name != "lidcam-write":
            self._is_waited_for.set()
        return super().wait(timeout)


class SlowDisk(Background):
    """Writes a chunk only when the run waits for one to be written."""

    def __init__(self, weight: float, name: str) -> None:
        super().__init__(weight, name)
        self._is_waited_for = Event()
        self._changed = Told(self._is_waited_for)

    def add(self, job: Callable[[], object], weight: int) -> None:
        def late() -> None:
            self._is_waited_for.wait()
            self._is_waited_for.clear()
            job()

        super().add(late, weight)


class Watch(RunObserver):
    """Counts the frames that are read and not yet written, and the bytes of chunks that there are."""

    def __init__(self) -> None:
        self.read = 0
        self.ahead: list[int] = []
        self.held: list[int] = []

    def reading(self, bundles: Iterator[SensorBundle]) -> Iterator[SensorBundle]:
        for bundle in bundles:
            self.read += 1
            yield bundle

    def advanced(self, progress: RunProgress) -> None:
        self.ahead.append(self.read - progress.frames)
        self.held.append(sum(chunk.size for chunk in CountedChunk.there))


@pytest.mark.parametrize("workers", [1, 2])
def test_no_more_waits_than_the_frames_in_work_and_some_chunks(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = Watch()
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)
    monkeypatch.setattr("lidcam.writers.mcap.output.WAITING_BYTES", WAITING_BYTES)
    monkeypatch.setattr("lidcam.writers.mcap.output.Background", SlowDisk)
    monkeypatch.setattr("lidcam.writers.mcap.output.Chunk", CountedChunk)
    monkeypatch.setattr("lidcam.processing.bundles", lambda *args: watch.reading(bundles(*args)))
    write_mcap(path := tmp_path / "drive.mcap", drive())
    settings = {"track.mode": "none", "detect3d.method": "cluster"}
    process_recording(make_job(path, tmp_path / "out.mcap", settings=settings, workers=workers), watch)
    window = 1 if workers == 1 else 2 * workers + 1
    assert len(watch.ahead) == FRAMES
    assert max(watch.ahead) < window + READ_AHEAD
    filled = CHUNK_BYTES + FRAME_BYTES  # the chunk that is being filled, at most
    assert WAITING_BYTES - filled < max(watch.held) <= WAITING_BYTES + filled < FRAMES * FRAME_BYTES / 2
