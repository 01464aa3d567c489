"""Rerun's bytes on their way to a file: what cannot be written is an error, and nothing waits for ever."""

import errno
import os
import resource
import threading
import time
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from frames import CONFIG, PROVENANCE, RIG, frame

import writers.rerun.stream
import writers.rerun.writer
from pipeline.core.errors import OutputError
from pipeline.core.images import Image
from pipeline.core.messages import RawMessage
from writers.outputs.transaction import OutputTransaction
from writers.rerun.stream import RerunStream, check_recording
from writers.rerun.writer import RerunResultWriter


class SlowDisk(FileIO):
    """Takes a few kilobytes at a time, and its time; `left` bytes until it is full."""

    left = 1 << 40
    delay_s = 0.0

    def write(self, data: Any, /) -> int:
        if self.left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        time.sleep(self.delay_s)
        count = super().write(memoryview(data)[: min(4000, self.left)])
        self.left -= count
        return count


def recording() -> rr.RecordingStream:
    return rr.RecordingStream("test", recording_id="a", send_properties=False)


def grey(message: RawMessage) -> Image:
    return Image(message.stamp_ns, "left", np.full((48, 64, 3), 128, np.uint8))


def log(stream: rr.RecordingStream, rows: int) -> None:
    rng = np.random.default_rng(0)  # hardly compressible
    for row in range(rows):
        points = rng.random((2000, 3)).astype(np.float32)
        stream.set_time("row", sequence=row)
        stream.log("points", rr.Points3D(points))
        stream.log("count", rr.Scalars(float(row)))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SlowDisk]:
    with SlowDisk(tmp_path / "out.rrd", "w+b") as file:
        yield file


@pytest.mark.parametrize("rows", [0, 1, 50])
def test_all_of_it_is_in_the_file(rows: int, disk: SlowDisk, tmp_path: Path) -> None:
    logged = recording()
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    log(logged, rows)
    stream.finish()
    if rows:
        check_recording(disk, tmp_path / "out.rrd", entity="count", rows=rows)
        with pytest.raises(OutputError, match=f"out.rrd: Rerun wrote {rows} of {rows + 1} frames"):
            check_recording(disk, tmp_path / "out.rrd", entity="count", rows=rows + 1)


@pytest.mark.parametrize("left", [1, 100_000])
def test_a_full_disk_is_an_error(left: int, disk: SlowDisk, tmp_path: Path) -> None:
    logged = recording()
    disk.left = left
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    log(logged, 50)
    with pytest.raises(OSError, match="No space left"):
        stream.finish()
    stream.discard()
    assert (tmp_path / "out.rrd").stat().st_size == left
    assert not any(thread.name == "lidcam-rerun" for thread in threading.enumerate())


def test_rerun_itself_does_not_go_on(disk: SlowDisk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged = recording()
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")

    def never(timeout_sec: float) -> None:
        raise RuntimeError(f"Flush timed out after {timeout_sec} s")

    monkeypatch.setattr(writers.rerun.stream, "STALL_S", 0.0)
    monkeypatch.setattr(logged, "flush", never)
    with pytest.raises(OutputError, match=r"out.rrd: Rerun has not written for 0 s \(Flush timed out"):
        stream.flush()
    stream.discard()


def test_a_recording_that_is_given_up_ends_at_once(disk: SlowDisk, tmp_path: Path) -> None:
    logged = recording()
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    disk.delay_s = 0.01
    log(logged, 200)
    stream.discard()
    assert (tmp_path / "out.rrd").stat().st_size < 200 * 2000 * 12 / 2  # the rest was not written
    assert not any(thread.name == "lidcam-rerun" for thread in threading.enumerate())


@pytest.mark.parametrize("kept", [0, 0.5, -1])
def test_a_damaged_recording_is_found(kept: float, disk: SlowDisk, tmp_path: Path) -> None:
    logged = recording()
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    log(logged, 20)
    stream.finish()
    size = disk.seek(0, os.SEEK_END)
    disk.truncate(int(size * kept) if 0 < kept < 1 else int(kept) % size)
    with pytest.raises(OutputError, match=r"out.rrd: what Rerun wrote cannot be read back"):
        check_recording(disk, tmp_path / "out.rrd", entity="count", rows=20)


def test_a_writer_that_fails_at_its_end_leaves_no_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.rrd"

    def fail(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(writers.rerun.writer, "place_eye", fail)
    with (
        pytest.raises(ZeroDivisionError),
        OutputTransaction([path]) as outputs,
        RerunResultWriter(outputs[path], RIG, CONFIG, PROVENANCE, decode_any_image=grey) as writer,
    ):
        writer.write(frame(0))
    assert not any(thread.name == "lidcam-rerun" for thread in threading.enumerate())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("max_bytes", [0, 200_000])
def test_a_writer_on_a_full_disk_ends_and_leaves_nothing(
    max_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No larger files than so: the same as a full disk, but for the reason."""
    monkeypatch.setattr(writers.rerun.writer, "MAX_WAITING_FRAMES", 5)
    (tmp_path / "out.rrd").write_bytes(b"an older one")
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)

    def write_on() -> None:
        path = tmp_path / "out.rrd"
        with (
            OutputTransaction([path]) as outputs,
            RerunResultWriter(outputs[path], RIG, CONFIG, PROVENANCE, decode_any_image=grey) as writer,
        ):
            resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, unlimited[1]))
            for index in range(1000):
                writer.write(frame(index))
        pytest.fail("the disk was not full")

    try:
        with pytest.raises(OutputError, match=r"out.rrd: cannot be written: File too large"):
            write_on()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"an older one"]
