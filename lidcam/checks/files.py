"""Files without messages, and files that are two recordings rather than the parts of one."""

from collections.abc import Sequence
from itertools import islice

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.readers.location import Location
from lidcam.readers.recording import Recording
from lidcam.run.warning import RunWarning

MIN_OVERLAP_NS = 1_000_000_000
"""Minimum overlap of two recordings, nanoseconds; parts of one overlap by less when the recorder changes files."""

MAX_NAMED = 3
"""Maximum number of pairs of files with their own warning."""


def check_not_empty(recording: Recording) -> None:
    """Check that there is anything to read.

    Raises:
        RecordingError: there is not.
    """
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")


class FileCheck:
    """Looks for topics whose messages come by turns from several files, in the order of `RawMessage.order[0]`."""

    def __init__(self, paths: Sequence[Location]) -> None:
        self._paths = paths
        self._first_ns: dict[tuple[str, int], int] = {}  # log time of the first message, by topic and file
        self._last: dict[str, int] = {}
        self._overlaps: dict[tuple[int, int], None] = {}

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        for topic, message in frame.bundle.messages.items():
            file = message.order[0]
            last = self._last.setdefault(topic, file)
            is_back = (topic, file) in self._first_ns and file != last
            if is_back and message.log_time_ns - self._first_ns[topic, last] > MIN_OVERLAP_NS:
                self._overlaps[min(file, last), max(file, last)] = None
            self._first_ns.setdefault((topic, file), message.log_time_ns)
            self._last[topic] = file

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each of the first pairs of files that hold the same topics at the same times."""
        return tuple(
            RunWarning(
                "files",
                f"{self._paths[one]} and {self._paths[other]} hold the same topics at the same times: their messages "
                "are mixed",
                "process them one by one, unless they are parts of one recording",
            )
            for one, other in islice(self._overlaps, MAX_NAMED)
        )
