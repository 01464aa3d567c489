"""Wrong usage quotes what was given, and a terminal obeys none of it."""

import sys

import pytest
import typer

from lidcam.commands import app, process_app
from lidcam.program import run_program

HOSTILE, SHOWN = "a\x1b]0;t\x07\x9b2J\nError: faked", "a\\x1b]0;t\\x07\\x9b2J\\nError: faked"


@pytest.mark.parametrize(
    ("program", "arguments", "told"),
    [
        (app, [HOSTILE], "No such command"),
        (app, ["inspect", f"--{HOSTILE}"], "No such option"),
        (app, ["process", "a.bag", f"{HOSTILE}.txt"], f"ends in .mcap, found {SHOWN}.txt"),
        (process_app, ["a.bag", "b.mcap", "--workers", HOSTILE], "--workers"),
        (process_app, ["a.bag", "b.mcap", "--on-bad-message", HOSTILE], "--on-bad-message"),
        (app, ["config", "show", "road", HOSTILE], "unexpected extra argument"),
    ],
)
def test_wrong_usage(
    program: typer.Typer,
    arguments: list[str],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
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


@pytest.mark.parametrize("arguments", [[], ["config"]])
def test_without_arguments_the_whole_help_is_told(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["lidcam", *arguments])
    with pytest.raises(SystemExit) as end:
        run_program(app, "lidcam")
    assert end.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) > 8


def test_ctrl_c_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    program = typer.Typer()

    @program.command()
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "argv", ["lidcam"])
    with pytest.raises(SystemExit) as end:
        run_program(program, "lidcam")
    assert end.value.code == 130


def test_letters_that_a_terminal_does_not_know_end_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = typer.Typer()

    @program.command()
    def speaks() -> None:
        typer.echo("\u00e9\udcff")

    monkeypatch.setattr(sys, "argv", ["lidcam"])
    run_program(program, "lidcam")
    assert capsys.readouterr().out == "\u00e9\\udcff\n"
