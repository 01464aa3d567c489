"""Tracks of a run: frames wait in a file until it is settled what is tracked in them.

A tracker that looks ahead knows the objects of a frame only when it has seen later ones. So frames pass a delay line
between the stages and all that sees results: memory does not grow with the delay, and nothing is read twice.
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
"""Size from which on a file gets no more frames: so much more than the frames that wait lies on the disk, at most."""


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

    A frame that is settled at once is handed on as it is. The others wait on the disk, in files without a name, which
    the system removes with the process. An error of `frames` is raised at once; the frames that wait are given up.

    Args:
        frames: The frames, in order.
        tracker: Gets each of them.
        folder: Where they wait; None for the system's temporary folder.
        stage: Entered with a bundle, around what is done for tracks.

    Raises:
        OutputError: frames cannot be kept on the disk.
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
    """Frames on the disk, first in, first out; a file goes as soon as all of its frames were read."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._file: io.FileIO | None = None  # to which frames are added, unless it is closed
        self._places: deque[tuple[io.FileIO, int]] = deque()

    def __len__(self) -> int:
        return len(self._places)

    def push(self, frame: FrameResult) -> None:
        """Add a frame.

        Raises:
            OutputError: there is no room, or no file can be made.
        """
        with self._errors_told():
            if self._file is None or self._file.closed or self._file.seek(0, os.SEEK_END) >= FILE_BYTES:
                self._file = tempfile.TemporaryFile(buffering=0, dir=self._folder)  # noqa: SIM115  # see `close`
            at = self._file.seek(0, os.SEEK_END)
            dump(frame, self._file)
            self._places.append((self._file, at))

    def pop(self) -> FrameResult:
        """Take the oldest frame.

        Raises:
            OutputError: it cannot be read.
        """
        file, at = self._places.popleft()
        with self._errors_told():
            file.seek(at)
            frame = cast(FrameResult, load(file))
            if not self._places or self._places[0][0] is not file:
                file.close()
        return frame

    def close(self) -> None:
        """Remove all of it."""
        for file in (self._file, *(file for file, _ in self._places)):
            if file is not None:
                file.close()

    @contextmanager
    def _errors_told(self) -> Iterator[None]:
        try:
            yield
        except OSError as err:
            raise OutputError(
                f"{self._folder or 'the temporary folder'}: frames that wait for their tracks cannot be kept there: "
                f"{err.strerror or err}: free some space, or set track.window_s to less"
            ) from err
