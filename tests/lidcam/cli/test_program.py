"""Errors become one line and an exit code, or keep their traceback; wrong usage quotes what was given."""

import errno
import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from logging_state import kept_logging

from lidcam.cli import app, process_app
from lidcam.cli.program import run_program
from lidcam.pipeline.core.errors import CheckError, IncompleteError, RecordingError

HOSTILE, SHOWN = "a\x1b]0;t\x07\x9b2J\nError: faked", "a\\x1b]0;t\\x07\\x9b2J\\nError: faked"

GONE = "the folder that this was started in is gone"


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(sys, "argv", ["lidcam"])
    monkeypatch.setenv("PYTHONSAFEPATH", "")
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
        (OSError(errno.ENOSPC, "No space left"), 1, "lidcam: error: standard output: No space left\n"),
        (OSError(errno.ENOSPC, "No space left", "a.mcap"), 1, "lidcam: error: a.mcap: No space left\n"),
        (FileNotFoundError(errno.ENOENT, "No such file"), 1, f"lidcam: error: {GONE}: change to another one\n"),
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


def test_its_processes_take_no_code_from_the_folder_it_runs_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('code of the folder')")
    monkeypatch.chdir(tmp_path)
    run_program(lambda *_, **__: subprocess.run([sys.executable, "-c", "import json"], check=True), "lidcam")


@pytest.mark.parametrize("error", [ZeroDivisionError("a bug"), PermissionError(errno.EACCES, "Permission denied")])
def test_bugs_keep_their_traceback(
    error: Exception, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    def program(*_: object, **__: object) -> None:
        logging.getLogger("lidcam").setLevel(logging.DEBUG)  # as with a log file
        logging.getLogger().addHandler(caplog.handler)
        raise error

    with pytest.raises(type(error)):
        run_program(program, "lidcam")
    assert [record.exc_info[1] for record in caplog.records if record.exc_info] == [error]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("program", "arguments", "told"),
    [
        (app, [HOSTILE], "No such command"),
        (app, ["inspect", f"--{HOSTILE}"], "No such option"),
        (app, ["batch", "-x.bag"], "No such option: -x. There is a file -x.bag: write ./-x.bag"),
        (app, ["process", "a.bag", f"{HOSTILE}.txt"], f"ends in .mcap, found {SHOWN}.txt"),
        (process_app, ["a.bag", "b.mcap", "--on-bad-message", HOSTILE], "--on-bad-message"),
    ],
)
def test_wrong_usage(
    program: typer.Typer,
    arguments: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-x.bag").touch()
    monkeypatch.setattr(sys, "argv", ["lidcam", *arguments])
    with pytest.raises(SystemExit) as end:
        run_program(program, "lidcam")
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    usage, hint, blank, error, rest = err.split("\n")
    assert usage.startswith("Usage: lidcam")
    assert hint.startswith("Try 'lidcam")
    assert (blank, rest) == ("", "")
    assert error.startswith("Error: ")
    assert told in error
    assert err.replace("\n", "").isprintable()
