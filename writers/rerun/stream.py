"""The bytes of a Rerun recording on their way to a file.

Rerun's own file sink writes on a thread of its own: when the disk is full, it says nothing, leaves a truncated file,
and may wait for ever. So it gets a pipe, which is never full for long, and what comes out of it is written here, where
an error is an error.
"""

import fcntl
import os
import threading
import time
import warnings
from contextlib import suppress
from io import FileIO
from pathlib import Path

import rerun as rr
from rerun.chunk import RrdReader

from pipeline.core.errors import OutputError

__all__ = ["RerunStream", "check_recording"]

PIPE_BYTES = 1 << 20
TICK_S = 0.1
STALL_S = 60.0
"""Rerun is given up when nothing has come of it for so long although something is to come."""


class RerunStream:
    """Writes what a Rerun recording logs to a file.

    Args:
        recording: The recording; all that it logs from now on is written.
        file: Open for writing.
        path: Name of the file in messages.

    Raises:
        OSError: no pipe can be made.
        OutputError: Rerun cannot write to it.
    """

    def __init__(self, recording: rr.RecordingStream, file: FileIO, path: Path) -> None:
        self._recording, self._file, self._path = recording, file, path
        self._written = 0
        self._error: Exception | None = None
        self._is_wanted, self._is_writing = True, False
        taken, given = os.pipe()
        self._copier = threading.Thread(target=self._copy, args=(taken,), name="lidcam-rerun", daemon=True)
        try:
            self._copier.start()  # before Rerun has a pipe that it would wait for
        except RuntimeError:  # no memory for a thread
            os.close(taken)
            os.close(given)
            raise
        try:
            with suppress(OSError, AttributeError):  # a larger pipe only saves time
                fcntl.fcntl(given, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
            recording.save(f"/dev/fd/{given}")
        except RuntimeError as err:
            raise OutputError(f"{path}: Rerun cannot write to a pipe; expected a folder /dev/fd ({err})") from err
        finally:
            os.close(given)  # the thread ends at once if there is no sink

    def settle(self) -> None:
        """Wait until all that was logged is in the file, or in the pipe.

        Raises:
            OSError: it cannot be written.
            OutputError: Rerun does not go on.
        """
        before, since_s = self._written, time.monotonic()
        while True:
            self.check()
            started_s = time.monotonic()
            try:
                self._recording.flush(timeout_sec=TICK_S)
            except RuntimeError as err:
                if self._written != before or self._is_writing:
                    before, since_s = self._written, started_s
                if started_s - since_s > STALL_S:
                    raise OutputError(f"{self._path}: Rerun has written nothing for {STALL_S:.0f} s ({err})") from err
                time.sleep(max(started_s + TICK_S - time.monotonic(), 0))
            else:
                return

    def check(self) -> None:
        """Whether all went well so far.

        Raises:
            OSError: it did not: the file cannot be written.
        """
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Write the end of the recording, too.

        Raises:
            OSError: the file cannot be written; the recording is still to be discarded.
            OutputError: Rerun does not go on; the same.
        """
        self.settle()
        self._end()
        self.check()

    def discard(self) -> None:
        """End the recording, if it has not ended; nothing more is written."""
        self._is_wanted = False
        self._end()

    def _end(self) -> None:
        self._recording.disconnect()
        self._copier.join()

    def _copy(self, taken: int) -> None:
        """Read the pipe to its end, whatever becomes of the bytes: else Rerun would wait for ever."""
        while piece := os.read(taken, PIPE_BYTES):
            try:
                self._write(memoryview(piece))
            except Exception as err:
                self._error = self._error or err
        os.close(taken)

    def _write(self, piece: memoryview) -> None:
        while piece and self._is_wanted and self._error is None:
            self._is_writing = True
            try:
                count = self._file.write(piece)
            finally:
                self._is_writing = False
            self._written += count
            piece = piece[count:]


def check_recording(file: FileIO, path: Path, *, entity: str, rows: int) -> None:
    """Read a Rerun recording's index back, and the chunks of one entity.

    Args:
        file: Open for reading.
        path: Its name in messages.
        entity: Path of the entity.
        rows: How often it was logged.

    Raises:
        OutputError: the recording is not whole.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # as Rerun says of a file without an end
            chunks = RrdReader(f"/dev/fd/{file.fileno()}").store().stream().filter(content=[entity], is_static=False)
            found = sum(chunk.num_rows for chunk in chunks)
    except Exception as err:  # whatever Rerun raises
        raise OutputError(f"{path}: what Rerun wrote cannot be read back: {err}") from err
    if found != rows:
        raise OutputError(f"{path}: Rerun wrote {found} of {rows} frames")
