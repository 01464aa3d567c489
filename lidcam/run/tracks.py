"""Tracks of a run: frames wait on disk until their tracks are settled.

An offline tracker settles the objects of a frame only after later frames. Frames pass a delay line between the stages
and everything that uses results: memory does not grow with the delay, and nothing is read twice.
"""

import io
import os
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Protocol, cast

from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.graph import Stamped
from lidcam.pipeline.parallel.transfer import dump, load

FILE_BYTES = 64 << 20
"""Size at which a new file is begun; at most this much disk is used beyond the waiting frames."""


class FrameTracker(Protocol):
    """Replaces the fused objects of frames by tracked ones; sees each frame once, in order."""

    def add_frame(self, frame: FrameResult) -> list[Fused]:
        """Add a frame; the objects of the oldest waiting frames that are settled, in order."""
        ...

    def finish(self) -> list[Fused]:
        """The objects of all waiting frames, in order."""
        ...


def tracked(
    frames: Iterable[FrameResult],
    tracker: FrameTracker,
    folder: Path | None,
    stage: Callable[[Stamped], AbstractContextManager[object]] = nullcontext,
) -> Generator[FrameResult, None, None]:
    """The frames, in order, with tracked objects, each as soon as it is settled.

    Frames that are not settled at once wait in unnamed temporary files. An error of `frames` is raised at once.
    `stage` is around the work for tracks.

    Raises:
        OutputError: frames cannot be buffered on disk.
    """
    with closing(_Spool(folder)) as spool:
        bundle = None
        for frame in frames:
            bundle = frame.bundle
            with stage(bundle):
                settled = tracker.add_frame(frame)
                if len(settled) > len(spool) + 1:
                    raise ValueError(f"tracker: expected at most {len(spool) + 1} settled frames, got {len(settled)}")
                if len(settled) <= len(spool):
                    spool.push(frame)
            for fused in settled:
                with stage(bundle):
                    oldest = spool.pop() if len(spool) else frame
                yield replace(oldest, fused=fused)
        if bundle is None:
            return
        with stage(bundle):
            settled = tracker.finish()
            if len(settled) != len(spool):
                raise ValueError(f"tracker: expected {len(spool)} settled frames at the end, got {len(settled)}")
        for fused in settled:
            with stage(bundle):
                oldest = spool.pop()
            yield replace(oldest, fused=fused)


class _Spool:
    """Frames on disk, first in, first out; a file is closed once all of its frames have been read."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._file: io.FileIO | None = None  # to which frames are added, unless it is closed
        self._places: deque[tuple[io.FileIO, int]] = deque()

    def __len__(self) -> int:
        return len(self._places)

    def push(self, frame: FrameResult) -> None:
        with self._errors_told():
            if self._file is None or self._file.closed or self._file.seek(0, os.SEEK_END) >= FILE_BYTES:
                self._file = tempfile.TemporaryFile(buffering=0, dir=self._folder)  # noqa: SIM115  # see `close`
            at = self._file.seek(0, os.SEEK_END)
            dump(frame, self._file)
            self._places.append((self._file, at))

    def pop(self) -> FrameResult:
        file, at = self._places.popleft()
        with self._errors_told():
            file.seek(at)
            frame = cast(FrameResult, load(file))
            if not self._places or self._places[0][0] is not file:
                file.close()
        return frame

    def close(self) -> None:
        for file in (self._file, *(file for file, _ in self._places)):
            if file is not None:
                file.close()

    @contextmanager
    def _errors_told(self) -> Iterator[None]:
        try:
            yield
        except OSError as err:
            place = self._folder or "the temporary folder"
            raise OutputError(
                f"{place}: cannot buffer frames there: {err.strerror or err}: free some space, or reduce track.window_s"
            ) from err
