"""What becomes of errors: one line and an exit code, or a traceback."""

import errno
import logging
import sys
from collections.abc import Iterator

import pytest
from logging_state import kept_logging

from lidcam.program import run_program
from pipeline.core.errors import CheckError, IncompleteError, RecordingError


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(sys, "argv", ["lidcam"])
    with kept_logging():
        yield


def noted() -> RecordingError:
    error = RecordingError("drive.bag: expected a recording, found none")
    error.add_note("while looking for lidars")
    return error


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (noted(), 1, "lidcam: error: drive.bag: expected a recording, found none (while looking for lidars)\n"),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            1,
            "lidcam: error: standard output: No space left on device\n",
        ),
        (OSError(errno.EIO, "Input/output error"), 1, "lidcam: error: standard output: Input/output error\n"),
        (OSError(errno.ENOSPC, "No space left", "a.mcap"), 1, "lidcam: error: a.mcap: No space left\n"),
        (CheckError("--strict: a"), 1, "lidcam: error: --strict: a\n"),
        (IncompleteError("a; b"), 3, "lidcam: incomplete: a; b; exit code 3\n"),
    ],
)
def test_known_errors_are_one_line(error: Exception, code: int, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    def program(*_: object, **__: object) -> None:
        raise error

    with pytest.raises(SystemExit) as end:
        run_program(program, "lidcam")
    assert end.value.code == code
    assert capsys.readouterr().err == told


@pytest.mark.parametrize("error", [ZeroDivisionError("a bug"), PermissionError(errno.EACCES, "Permission denied")])
def test_bugs_keep_their_traceback(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    records: list[logging.LogRecord] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            records.append(record)

    def program(*_: object, **__: object) -> None:
        logging.getLogger("lidcam").setLevel(logging.DEBUG)  # as with a log file
        logging.getLogger().addHandler(Kept())
        raise error

    with pytest.raises(type(error)):
        run_program(program, "lidcam")
    assert [record.exc_info[1] for record in records if record.exc_info] == [error]
    assert capsys.readouterr().err == ""
