"""Frames wait for their tracks: none is lost, altered or held in memory, whenever the tracker settles them."""

import io
import os
import tempfile
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import write_mcap
from helpers import CLUSTERS
from hypothesis import given
from hypothesis import strategies as st
from small_drive import small_drive

import lidcam
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.run.tracks import FrameTracker, tracked

NEVER = 1000


class Late:
    """Leaves all objects as they are; settles `step` frames as soon as so many and `delay` more are not settled."""

    def __init__(self, delay: int, step: int = 1) -> None:
        self._delay, self._step = delay, step
        self._open: list[Fused] = []

    def add_frame(self, frame: FrameResult) -> list[Fused]:
        self._open.append(marked(frame.fused, frame.bundle.index))
        return self._take(self._step if len(self._open) >= self._delay + self._step else 0)

    def finish(self) -> list[Fused]:
        return self._take(len(self._open))

    def _take(self, count: int) -> list[Fused]:
        taken, self._open = self._open[:count], self._open[count:]
        return taken


class Scheduled(Late):
    """Settles as many frames after each one as it is told, if there are so many."""

    def __init__(self, counts: list[int]) -> None:
        super().__init__(0)
        self._counts = iter(counts)

    def add_frame(self, frame: FrameResult) -> list[Fused]:
        self._open.append(marked(frame.fused, frame.bundle.index))
        return self._take(next(self._counts))


def marked(fused: Fused, index: int) -> Fused:
    return replace(fused, left_out={"frame": index})


@cache
def one_frame() -> FrameResult:
    with tempfile.TemporaryDirectory() as folder:
        write_mcap(path := Path(folder) / "drive.mcap", small_drive("cdr", frames=2))
        return list(lidcam.iter_frames(path, settings=[CLUSTERS], workers=1))[-1]


def frames(count: int, *, extra_bytes: int = 0) -> Iterator[FrameResult]:
    frame = one_frame()
    for index in range(count):
        beliefs = np.full(extra_bytes // 8, float(index)) if extra_bytes else frame.beliefs
        yield replace(frame, bundle=replace(frame.bundle, index=index), beliefs=beliefs)


@pytest.fixture
def files(monkeypatch: pytest.MonkeyPatch) -> list[io.FileIO]:
    """The files in which frames wait, those of the past, too."""
    made: list[io.FileIO] = []
    make = tempfile.TemporaryFile

    def kept(**options: Any) -> Any:
        file = make(**options)
        made.append(file)
        return file

    monkeypatch.setattr("lidcam.run.tracks.tempfile.TemporaryFile", kept)
    return made


@given(st.lists(st.integers(0, 4), max_size=30), st.sampled_from([0, 60_000, 1 << 20]))
def test_every_frame_comes_once_in_order_with_its_own_objects(counts: list[int], file_bytes: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lidcam.run.tracks.FILE_BYTES", file_bytes)
        found = list(tracked(frames(len(counts)), Scheduled(counts), None))
    assert [frame.bundle.index for frame in found] == list(range(len(counts)))
    assert [frame.fused.left_out for frame in found] == [{"frame": index} for index in range(len(counts))]


@pytest.mark.parametrize("tracker", [Late(0), Late(1), Late(NEVER)])
def test_a_frame_comes_back_as_it_was(tracker: FrameTracker) -> None:
    before = one_frame()
    for after in tracked(frames(3), tracker, None):
        for name, message in before.bundle.messages.items():
            same = after.bundle.messages[name]
            assert bytes(same.data) == bytes(message.data)
            assert same._replace(data=b"") == message._replace(data=b"")
        np.testing.assert_array_equal(after.combined.cloud.xyz, before.combined.cloud.xyz, strict=True)
        np.testing.assert_array_equal(after.beliefs, before.beliefs, strict=True)
        assert {**after.views}.keys() == {**before.views}.keys()
        assert after.bundle.stamp_ns == before.bundle.stamp_ns


def test_frames_wait_on_the_disk_and_files_that_were_read_go(
    files: list[io.FileIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    size, delay, step, file_bytes = 1 << 20, 5, 10, 3 << 20
    monkeypatch.setattr("lidcam.run.tracks.FILE_BYTES", file_bytes)
    one_frame()
    on_disk = []
    tracemalloc.start()
    try:
        for _ in tracked(frames(60, extra_bytes=size), Late(delay, step), None):
            on_disk.append(sum(os.fstat(file.fileno()).st_size for file in files if not file.closed))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 6 * size, "15 frames wait"
    assert (delay + step - 2) * size < max(on_disk) < (delay + step + 1) * (size + 100_000) + file_bytes
    assert all(file.closed for file in files)


@pytest.mark.parametrize("delay", [1, 3, NEVER])
def test_files_are_closed_when_the_frames_end_with_an_error(delay: int, files: list[io.FileIO]) -> None:
    def failing() -> Iterator[FrameResult]:
        yield from frames(6)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(tracked(failing(), Late(delay), None))
    assert files
    assert all(file.closed for file in files)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full, the disk that is always full")
def test_a_full_disk_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    full = lambda **_: open("/dev/full", "r+b", buffering=0)  # noqa: E731, PTH123, SIM115  # closed with the spool
    monkeypatch.setattr("lidcam.run.tracks.tempfile.TemporaryFile", full)
    with pytest.raises(lidcam.OutputError) as caught:
        list(tracked(frames(3), Late(2), tmp_path))
    line = "cannot buffer frames there: No space left on device: free some space, or reduce track.window_s"
    assert str(caught.value) == f"{tmp_path}: {line}"
