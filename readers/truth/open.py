"""Finding the truth about a result: in the result itself, or in another recording."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.core.errors import RecordingError
from readers.location import Location
from readers.open import open_recording
from readers.recording import Closing, ReadOptions, Recording
from readers.results.records import is_result
from readers.results.result import RESULT_TOPICS, Result
from readers.truth.recorded import RecordedTruth
from readers.truth.source import TruthSource
from readers.truth.topics import find_truth_topics

__all__ = ["OpenTruth", "open_truth"]


class OpenTruth(Closing):
    """The truth about a result; `open_truth` opens it.

    Attributes:
        source: The truth; None if there is none.
        reason: Why there is none; empty if there is one.
        poses: Recordings that may join the truth's frame with the site frame, the best first.
    """

    def __init__(
        self, source: TruthSource | None, reason: str, poses: Sequence[Recording], own: Sequence[Recording] = ()
    ) -> None:
        self.source, self.reason, self.poses = source, reason, tuple(poses)
        self._own = tuple(own)

    def close(self) -> None:
        """Close what was opened for the truth; the result stays open."""
        for recording in self._own:
            recording.close()


def open_truth(result: Result, paths: Sequence[Location] = (), *, topic: str = "") -> OpenTruth:
    """Find the truth, to be used as a context manager.

    Args:
        result: The open result.
        paths: The files of a recording with the truth, in any container; none: the truth that the result carries.
        topic: The topic to take, whatever it is called.

    Raises:
        ConfigError: there is no such topic.
        RecordingError: the recording cannot be read, or has no truth. A result without truth is no error.
    """
    if not paths:
        found = find_truth_topics(result.recording, RESULT_TOPICS, result.cameras, topic)
        if isinstance(found, str):
            return OpenTruth(None, f"{found}; give the recording that has it (--truth)", (result.recording,))
        truth = RecordedTruth(result.recording, found, result.config)
        return OpenTruth(truth, "", (result.recording,))
    results = RESULT_TOPICS if any(isinstance(path, Path) and is_result(path) for path in paths) else frozenset()
    recording = open_recording(paths, ReadOptions(limits=result.config.limits))
    try:
        source = _recorded(recording, results, result, topic)
    except BaseException:
        recording.close()
        raise
    return OpenTruth(source, "", (recording, result.recording), (recording,))


def _recorded(recording: Recording, results: frozenset[str], result: Result, topic: str) -> RecordedTruth:
    """The truth of another recording.

    Raises:
        ConfigError: it does not have that topic.
        RecordingError: it has no truth.
    """
    found = find_truth_topics(recording, results, [camera.name for camera in result.rig.cameras], topic)
    if isinstance(found, str):
        raise RecordingError(found)
    return RecordedTruth(recording, found, result.config)
