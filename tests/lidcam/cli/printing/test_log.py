"""What is told on stderr and in a log file."""

import logging
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from logging_state import kept_logging

from lidcam.cli.printing.log import Verbosity, configure_logging, progress_log, remark_log, verdict_log
from lidcam.pipeline.core.errors import OutputError


@pytest.fixture(autouse=True)
def as_it_was() -> Iterator[None]:
    with kept_logging():
        yield


def tell_everything() -> None:
    logging.getLogger("lidcam.readers.open").debug("debug of a reader")
    logging.getLogger("lidcam.processing").info("info")
    logging.getLogger("lidcam.processing").warning("warning")
    logging.getLogger("lidcam.cli.program").error("error")
    logging.getLogger("library").info("of a library")
    logging.getLogger("library").warning("warning of a library")
    progress_log.info("progress")
    remark_log.info("wrote out.bag")
    verdict_log.warning("incomplete: %s; exit code 3", "/points")


LAST = "lidcam: incomplete: /points; exit code 3"
"""Always shown."""

NORMAL = [
    "lidcam: warning",
    "lidcam: error: error",
    "lidcam: warning of a library",
    "lidcam: progress",
    "wrote out.bag",
    LAST,
]


@pytest.mark.parametrize(
    ("verbosity", "is_terminal", "lines"),
    [
        (Verbosity.NORMAL, False, NORMAL),
        (Verbosity.NORMAL, True, [line for line in NORMAL if "progress" not in line]),  # there a bar is drawn
        (Verbosity.QUIET, False, ["lidcam: error: error", LAST]),
        (Verbosity.VERBOSE, True, ["lidcam.readers.open: debug of a reader", "lidcam: info", *NORMAL]),
    ],
)
def test_stderr(
    verbosity: Verbosity,
    is_terminal: bool,
    lines: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "30")
    configure_logging(verbosity)
    tell_everything()
    told = capsys.readouterr()
    assert ("\n  " in told.err) == is_terminal  # the last line is folded
    assert not is_terminal or all(len(line) <= 30 for line in told.err.splitlines())
    assert told.err.replace("\n  ", " ").splitlines() == lines
    assert told.out == ""


@pytest.mark.parametrize("verbosity", [Verbosity.NORMAL, Verbosity.QUIET])
def test_a_log_file_gets_everything_with_times(tmp_path: Path, verbosity: Verbosity) -> None:
    file = tmp_path / "run.log"
    before = "2026-01-01T00:00:00.000Z INFO    lidcam.processing: of an earlier run"
    file.write_text(f"{before}\nand more\n", encoding="utf-8")
    configure_logging(verbosity, file)
    tell_everything()
    first, _, *lines = file.read_text(encoding="utf-8").splitlines()
    assert first == before
    time_of = re.compile(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z ")
    assert all(time_of.match(line) for line in lines)
    quiet = verbosity == Verbosity.QUIET
    expected = [
        "DEBUG   lidcam.readers.open: debug of a reader",
        "INFO    lidcam.processing: info",
        "WARNING lidcam.processing: warning",
    ]
    expected += ["ERROR   lidcam.cli.program: error", "WARNING library: warning of a library"]
    expected += [] if quiet else ["INFO    lidcam.progress: progress"]
    assert [time_of.sub("", line) for line in lines] == [
        *expected,
        "INFO    lidcam.remarks: wrote out.bag",
        "WARNING lidcam.verdict: incomplete: /points; exit code 3",
    ]


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="expected a log file that can be written: No such file or directory"):
        configure_logging(Verbosity.NORMAL, tmp_path / "missing" / "run.log")


def test_no_other_file_is_appended_to(tmp_path: Path) -> None:
    file = tmp_path / "truth.txt"
    file.write_text("0.1 1 2 3")
    with pytest.raises(OutputError, match=r"truth\.txt: expected a new file or an earlier log of lidcam"):
        configure_logging(Verbosity.NORMAL, file)
    (tmp_path / "run.log").symlink_to(file)
    with pytest.raises(OutputError, match=r"run\.log: expected a log file, found a link"):
        configure_logging(Verbosity.NORMAL, tmp_path / "run.log")
    assert file.read_text() == "0.1 1 2 3"
