"""The errors that lidcam raises for faulty input, calibration or settings.

    LidcamError
    ├── RecordingError     a recording cannot be opened or read
    │   └── MessageError   one message cannot be decoded
    ├── CalibrationError   intrinsics, extrinsics or a rig file are unusable
    │   └── FrameError     transforms of different frames were composed, or no path joins two frames
    ├── ConfigError        the settings are wrong
    ├── ModelError         a network cannot be loaded or does not have the expected layout
    ├── OutputError        a result cannot be written
    ├── CheckError         a run went through, and used less of the recording than it had to
    └── IncompleteError    a command went through, and part of the recording could not be used

Each message is one line: what was expected, what was found, what to do. The command line prints it and exits with 1,
after an `IncompleteError` with 3; any other exception is a bug and keeps its traceback.
"""

__all__ = [
    "CalibrationError",
    "CheckError",
    "ConfigError",
    "FrameError",
    "IncompleteError",
    "LidcamError",
    "MessageError",
    "ModelError",
    "OutputError",
    "RecordingError",
]

MAX_CHARACTERS = 4000


class LidcamError(Exception):
    """Base of all errors caused by the input, the calibration or the settings.

    Its text is one line of bounded length, whatever names and values from a file it contains.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > MAX_CHARACTERS:
            text = f"{text[:MAX_CHARACTERS]}..."
        if text.isprintable():
            return text
        return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


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


class CheckError(LidcamError):
    """A run went through, and used less of the recording than it had to."""


class IncompleteError(LidcamError):
    """A command went through, and part of the recording could not be used."""
