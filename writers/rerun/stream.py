"""The bytes of a Rerun recording on their way to a file.

Rerun's own file sink says nothing when the disk is full, and leaves a truncated file. So it gets a pipe, and the bytes
that come out of it are written here, where an error is an error. (`rr.BinaryStream` is no way around the pipe: each of
its reads ends with the end of a file.)
"""

import os
import threading
import time
from contextlib import suppress
from io import FileIO
from pathlib import Path

import rerun as rr

from lidcam.pipeline.core.errors import OutputError

PIPE_BYTES = 1 << 20
TICK_S = 1.0
"""Maximum time that a signal waits, seconds."""

STALL_S = 600.0
"""Time after which Rerun is given up if its data are not in the file, seconds."""


class RerunStream:
    """Writes all that a Rerun recording logs from now on to an open file, which messages call `path`.

    Raises OutputError where Rerun does not go on, and the OSError of a write that fails.
    """

    def __init__(self, recording: rr.RecordingStream, file: FileIO, path: Path) -> None:
        self._recording, self._file, self._path = recording, file, path
        self._error: Exception | None = None
        self._is_wanted = True
        taken, given = os.pipe()
        self._copier = threading.Thread(target=self._copy, args=(taken,), name="lidcam-rerun", daemon=True)
        self._copier.start()  # before Rerun has a pipe that it would wait for
        try:
            with suppress(ImportError, OSError, AttributeError):  # a larger pipe only saves time
                import fcntl

                fcntl.fcntl(given, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
            recording.save(f"/dev/fd/{given}")
        except RuntimeError as err:
            raise OutputError(f"{path}: Rerun cannot write to a pipe; expected a folder /dev/fd ({err})") from err
        finally:
            os.close(given)  # the thread ends at once if there is no sink

    def flush(self) -> None:
        """Wait until all that was logged is in the file, or in the pipe."""
        until_s = time.monotonic() + STALL_S
        while True:
            self.check()
            try:
                self._recording.flush(timeout_sec=TICK_S)
            except RuntimeError as err:
                if time.monotonic() > until_s:
                    raise OutputError(f"{self._path}: Rerun has not written for {STALL_S:.0f} s ({err})") from err
            else:
                return

    def check(self) -> None:
        """Raise the OSError for which the file could not be written, if there was one."""
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Write the end of the recording, too; after an error, as of `flush`, it is still to be discarded."""
        self.flush()
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
            left = memoryview(piece)
            try:
                while left and self._is_wanted and self._error is None:
                    left = left[self._file.write(left) :]
            except Exception as err:
                self._error = err
        os.close(taken)
