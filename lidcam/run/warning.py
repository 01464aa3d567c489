"""Messages of a run to its user: warnings about the result, and the line of an error."""

import errno
from dataclasses import dataclass

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.text import one_line

NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}

MAY_BE_MISSING = {"rerun": "rerun-sdk", "pyarrow": "pyarrow", "scipy": "scipy", "jinja2": "jinja2"}
"""Packages, by module, that an installation may leave out: most commands do without them (docs/install.md)."""


@dataclass(frozen=True, slots=True)
class RunWarning:
    """Why part of a result may be missing or wrong, and what to do."""

    subject: str  # Name of the sensor, the topic or the step
    finding: str  # The finding
    remedy: str  # The remedy to try

    def __str__(self) -> str:
        return f"{self.subject}: {self.finding}; {self.remedy}"


def error_line(err: Exception) -> str:
    """The line that a command prints for an error; empty for a bug, which keeps its traceback."""
    if isinstance(err, LidcamError):
        return one_line(err) + "".join(f" ({note})" for note in getattr(err, "__notes__", ()))
    if isinstance(err, OSError):
        if err.errno == errno.ENOENT and err.filename is None:
            return "the folder that this was started in is gone: change to another one"
        if err.errno in NO_SPACE or (err.errno in FORBIDDEN and err.filename is not None):
            return f"{err.filename or 'standard output'}: {err.strerror}"
    if isinstance(err, ModuleNotFoundError) and (package := MAY_BE_MISSING.get((err.name or "").partition(".")[0])):
        return f"this needs {package}, which is not installed: pip install {package}"
    return ""
