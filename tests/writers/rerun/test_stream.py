"""Rerun's bytes on their way to a file: what cannot be written is an error, and nothing waits for ever."""

import errno
import threading
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import rerun as rr
from frames import CONFIG, PROVENANCE, RIG, frame

import lidcam.writers.rerun.stream
import lidcam.writers.rerun.writer
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.messages.image import decode_any_image
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.rerun.stream import RerunStream
from lidcam.writers.rerun.writer import RerunResultWriter

WRITE_BYTES = 4000


class Disk(FileIO):
    """Takes a few kilobytes at a time; `left` bytes until it is full."""

    left = 1 << 40

    def write(self, data: Any, /) -> int:
        if self.left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = super().write(memoryview(data)[: min(WRITE_BYTES, self.left)])
        self.left -= count
        return count


def recording() -> rr.RecordingStream:
    return rr.RecordingStream("test", recording_id="a", send_properties=False)


def log(stream: rr.RecordingStream, rows: int) -> None:
    rng = np.random.default_rng(0)  # hardly compressible
    for row in range(rows):
        points = rng.random((2000, 3)).astype(np.float32)
        stream.set_time("row", sequence=row)
        stream.log("points", rr.Points3D(points))
        stream.log("count", rr.Scalars(float(row)))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    with Disk(tmp_path / "out.rrd", "w+b") as file:
        yield file


@pytest.mark.parametrize("left", [1, 100_000])
def test_a_full_disk_is_an_error(left: int, disk: Disk, tmp_path: Path) -> None:
    logged = recording()
    disk.left = left
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    log(logged, 50)
    with pytest.raises(OSError, match="No space left"):
        stream.finish()
    stream.discard()
    assert (tmp_path / "out.rrd").stat().st_size == left
    assert not any(thread.name == "lidcam-rerun" for thread in threading.enumerate())


def test_rerun_itself_does_not_go_on(disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged = recording()
    stream = RerunStream(logged, disk, tmp_path / "out.rrd")
    monkeypatch.setattr(lidcam.writers.rerun.stream, "STALL_S", 0.0)
    monkeypatch.setattr(logged, "flush", Mock(side_effect=RuntimeError("Flush timed out after 0 s")))
    with pytest.raises(OutputError, match=r"out.rrd: Rerun has not written for 0 s \(Flush timed out"):
        stream.flush()
    stream.discard()


def test_a_writer_that_fails_at_its_end_leaves_no_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.rrd"
    monkeypatch.setattr(lidcam.writers.rerun.writer, "place_eye", Mock(side_effect=ZeroDivisionError))
    with (
        pytest.raises(ZeroDivisionError),
        OutputTransaction([path]) as outputs,
        RerunResultWriter(outputs[path], RIG, CONFIG, PROVENANCE, decode_any_image=decode_any_image) as writer,
    ):
        writer.write(frame(0))
    assert not any(thread.name == "lidcam-rerun" for thread in threading.enumerate())
    assert list(tmp_path.iterdir()) == []
