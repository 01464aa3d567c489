"""Recordings without messages."""

from pipeline.core.errors import RecordingError
from readers.recording import Recording

__all__ = ["check_not_empty"]


def check_not_empty(recording: Recording) -> None:
    """Whether there is anything to read.

    Raises:
        RecordingError: there is not.
    """
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")
