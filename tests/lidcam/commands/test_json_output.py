"""Where a command puts its JSON."""

import json
from pathlib import Path
from typing import Annotated

import pytest
import typer

from lidcam.commands.json_output import json_output
from lidcam.options import JsonCommand, JsonTarget
from lidcam.printing.terminal import console
from pipeline.core.errors import LidcamError, OutputError


def write(path: Path, tree: object, *, overwrite: bool = False) -> None:
    with json_output(str(path), inputs=(), overwrite=overwrite) as output:
        output.tree = tree


@pytest.mark.parametrize(("target", "shown"), [(None, "tables\n"), ("-", '{\n  "a": 1\n}\n')])
def test_it_is_printed_in_place_of_the_tables(
    target: str | None, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with json_output(target, inputs=(), overwrite=False) as output:
        output.tree = {"a": 1}
    output.show(console(), lambda: print("tables"))
    assert capsys.readouterr().out == shown


def test_it_is_written_beside_the_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.json"
    with json_output(str(path), inputs=(), overwrite=False) as output:
        assert not path.exists()
        output.tree = {"a": "\x1b"}
    output.show(console(), lambda: print("tables"))
    assert capsys.readouterr().out == "tables\n"
    text = path.read_text()
    assert text.endswith("}\n")
    assert "\x1b" not in text
    assert json.loads(text)["a"] == "\x1b"


def test_only_what_an_earlier_run_wrote_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write(path, {"a": 1})
    write(path, {"a": 2})
    assert json.loads(path.read_text())["a"] == 2
    path.write_text('{"mine": 1}\n')
    with pytest.raises(OutputError, match="replace it with --overwrite"):
        write(path, {"a": 3})
    assert json.loads(path.read_text()) == {"mine": 1}
    write(path, {"a": 3}, overwrite=True)
    assert json.loads(path.read_text())["a"] == 3


def test_no_input_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("{}")
    with (
        pytest.raises(OutputError, match="is an input of this run"),
        json_output(str(path), inputs=[path], overwrite=True),
    ):
        pass
    assert path.read_text() == "{}"


def test_a_command_that_fails_writes_none(tmp_path: Path) -> None:
    with (
        pytest.raises(LidcamError),
        json_output(str(tmp_path / "a.json"), inputs=(), overwrite=False),
    ):
        raise LidcamError("bad")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("args", "parsed"),
    [
        ([], ([], None)),
        (["--json"], ([], "-")),
        (["a", "--json"], (["a"], "-")),
        (["--json", "a"], (["a"], "-")),
        (["--json", "a.json"], ([], "a.json")),
        (["--json=a.json", "b"], (["b"], "a.json")),
        (["--json", "-", "b"], (["b"], "-")),
        (["--json", "--flag"], ([], "-")),
        (["--json", "--", "a.json"], (["a.json"], "-")),
        (["--", "--json"], (["--json"], None)),
    ],
)
def test_the_file_may_be_left_out(args: list[str], parsed: tuple[list[str], str | None]) -> None:
    app = typer.Typer()
    seen: list[tuple[list[str], str | None]] = []

    @app.command(cls=JsonCommand)
    def command(
        names: Annotated[list[str] | None, typer.Argument()] = None,
        json: JsonTarget = None,
        flag: Annotated[bool, typer.Option("--flag")] = False,
    ) -> None:
        seen.append((names or [], json))
        assert flag == ("--flag" in args)

    app(args, standalone_mode=False)
    assert seen == [parsed]
