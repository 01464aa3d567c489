"""The log of a program: the one place that configures logging.

Warnings, errors and remarks ("wrote out.bag ...") go to stderr, and so do lines of progress if stderr is no terminal. A
log file gets everything, with times.
"""

import logging
import os
import re
import sys
import time
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from typing import Any

from lidcam.cli.printing.escaping import visible, visible_lines
from lidcam.pipeline.core.errors import OutputError

remark_log = logging.getLogger("lidcam.remarks")
"""Files that were written, at level INFO: shown unless --quiet is given."""

progress_log = logging.getLogger("lidcam.progress")
"""Progress of a command, at level INFO; off with --quiet, like the progress bar."""

verdict_log = logging.getLogger("lidcam.verdict")
"""The reason why a command that has done its work does not exit with 0: always shown, as the last line."""

LOG_LINE = re.compile(rb"[-\d]{10}T[:\d]{8}\.\d{3}Z ")
"""The beginning of each line of a log file."""


class Verbosity(IntEnum):
    """The lowest level that stderr shows."""

    QUIET = logging.ERROR
    NORMAL = logging.WARNING
    VERBOSE = logging.DEBUG


def configure_logging(verbosity: Verbosity = Verbosity.NORMAL, log_file: Path | None = None) -> None:
    """Send the log of this program to stderr, and to a file; what was configured before is undone."""
    handlers: list[logging.Handler] = [_Stderr(verbosity)]
    if log_file is not None:
        try:
            _check_log(log_file)
            file = logging.FileHandler(log_file, encoding="utf-8")
        except OSError as err:
            raise OutputError(f"{log_file}: expected a log file that can be written: {err.strerror}") from err
        file.setFormatter(_Timed())
        handlers.append(file)
    logging.basicConfig(level=logging.WARNING, handlers=handlers, force=True)
    everything = log_file is not None or verbosity == Verbosity.VERBOSE
    logging.getLogger("lidcam").setLevel(logging.DEBUG if everything else logging.INFO)  # libraries log too much
    progress_log.setLevel(logging.ERROR if verbosity == Verbosity.QUIET else logging.NOTSET)


def is_verbose() -> bool:
    """Whether the whole log is shown on stderr."""
    return any(isinstance(one, _Stderr) and one.verbosity == Verbosity.VERBOSE for one in logging.getLogger().handlers)


def _check_log(path: Path) -> None:
    """Check that a log can be appended to a file: a new or empty one, or a log; no link, which may lead anywhere."""
    if not os.path.lexists(path):
        return
    if path.is_symlink() or not path.is_file():
        raise OutputError(f"{path}: expected a log file, found a link, a folder, a device or a pipe")
    with path.open("rb") as file:
        head = file.read(len("2026-01-01T00:00:00.000Z "))
    if head and not LOG_LINE.fullmatch(head):
        raise OutputError(f"{path}: expected a new file or an earlier log of lidcam, found another file")


def _is_remark(record: logging.LogRecord) -> bool:
    return record.name == remark_log.name and record.levelno == logging.INFO


class _Stderr(logging.Handler):
    """Writes to what `sys.stderr` is at the moment: a progress bar takes its place for a while."""

    def __init__(self, verbosity: Verbosity) -> None:
        super().__init__()
        self.verbosity = verbosity
        self.addFilter(self._is_shown)

    def _is_shown(self, record: logging.LogRecord) -> bool:
        if record.exc_info:
            return False  # the interpreter prints the traceback
        if record.levelno >= self.verbosity or record.name == verdict_log.name:
            return True
        is_remark = record.name == remark_log.name or (record.name == progress_log.name and not sys.stderr.isatty())
        return is_remark and self.verbosity == Verbosity.NORMAL

    def format(self, record: logging.LogRecord) -> str:
        text = visible(record.getMessage())
        if _is_remark(record):
            return text
        if record.levelno >= logging.ERROR:
            return f"lidcam: error: {text}"
        return f"lidcam: {text}" if record.levelno >= logging.INFO else f"{record.name}: {text}"

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # nobody reads it any more, or its disk is full: no reason to end a run
            text = self.format(record)
            if sys.stderr.isatty() and not _is_remark(record):  # whose paths can be copied
                from lidcam.cli.printing.terminal import console, show_line  # obeys NO_COLOR

                style = "red" if record.levelno >= logging.ERROR else "yellow" * (record.levelno >= logging.WARNING)
                show_line(console(stderr=True), text, style)
                return
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()


class _Timed(logging.Formatter):
    """Lines with the time in UTC, the level and the logger."""

    converter = staticmethod(time.gmtime)

    def __init__(self) -> None:
        super().__init__("%(asctime)s.%(msecs)03dZ %(levelname)-7s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = visible(record.getMessage())
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:
        return visible_lines(super().formatException(ei))
