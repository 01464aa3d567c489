"""The errors that lidcam raises for faulty input, calibration or settings.

Each message is one line: what was expected, what was found, what to do. The command line prints it and exits with 1,
after an `IncompleteError` with 3; any other exception is a bug and keeps its traceback.
"""

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager

from lidcam.pipeline.core.text import visible

MAX_CHARACTERS = 4000

OPENCV_NO_MEMORY = -4
"""`cv::Error::StsNoMem`."""

NO_MEMORY = re.compile(
    r"out of memory|cannot allocate memory|failed to allocate|could not allocate|bad_alloc|can.t start new thread", re.I
)
"""How libraries say it that have no error of their own for it: zstandard, lz4, onnxruntime, threads without a stack."""

WANTED = re.compile(r"\b\d[\d.]* ?[KMGTPE]?i?B(?:ytes)?\b")
"""The size in numpy's message: `Unable to allocate 1.2 GiB for an array with shape ...`."""


class LidcamError(Exception):
    """Base of all errors caused by the input, the calibration or the settings.

    Its text is one line of bounded length, whatever names and values from a file it contains.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > MAX_CHARACTERS:
            text = f"{text[:MAX_CHARACTERS]}..."
        return visible(text)


class RecordingError(LidcamError):
    """A recording cannot be opened or read."""


class MessageError(RecordingError):
    """One message cannot be decoded; others may be."""


class CalibrationError(LidcamError):
    """Intrinsics, extrinsics or a rig file are unusable."""


class FrameError(CalibrationError):
    """Transforms of different frames were composed, or no path joins two frames."""


class ConfigError(LidcamError):
    """The settings are wrong."""


class ModelError(LidcamError):
    """A network cannot be loaded or does not have the expected layout."""


class OutputError(LidcamError):
    """A result cannot be written."""


class ShortMemoryError(LidcamError):
    """The machine has too little memory for what is asked of it; the files may be sound."""


class WorkerError(LidcamError):
    """A process that shares the work cannot be started, or has died."""


class CheckError(LidcamError):
    """A command went through, and its result is less than what was asked for.

    Attributes:
        lines: The shortcomings, one line each.
    """

    def __init__(self, *lines: str) -> None:
        super().__init__("; ".join(lines))
        self.lines = lines


class IncompleteError(LidcamError):
    """A command went through, and part of the recording could not be used."""


def is_short_memory(err: BaseException) -> bool:
    """Whether an error of any library means that memory could not be had."""
    if isinstance(err, (MemoryError, ShortMemoryError)):
        return True
    if isinstance(err, LidcamError):
        return False
    if isinstance(err, OSError):
        return err.errno == errno.ENOMEM
    if type(err).__module__.startswith("cv2"):
        return getattr(err, "code", None) == OPENCV_NO_MEMORY
    return bool(NO_MEMORY.search(str(err)[:MAX_CHARACTERS]))


@contextmanager
def short_memory_told(doing: str) -> Iterator[None]:
    """Turn what any library raises for want of memory into a `ShortMemoryError`; `doing` is as in `read a.bag`."""
    try:
        yield
    except Exception as err:
        if isinstance(err, LidcamError) or not is_short_memory(err):
            raise
        wanted = WANTED.search(str(err)[:MAX_CHARACTERS])
        size = f": {wanted[0]} could not be had" if wanted else ""
        told = ShortMemoryError(
            f"not enough memory to {doing}{size}; end other programs, set run.workers to 1, or use a machine with "
            "more memory"
        )
        for note in getattr(err, "__notes__", ()):
            told.add_note(note)
        raise told from err
