"""Where a command puts its JSON."""

import json
from pathlib import Path

import pytest

from lidcam.commands.json_output import json_output
from lidcam.printing.terminal import console
from pipeline.core.errors import LidcamError, OutputError


def write(path: Path, tree: object, *, overwrite: bool = False) -> None:
    with json_output(path, is_printed=False, inputs=(), overwrite=overwrite) as output:
        output.tree = tree


@pytest.mark.parametrize(("is_printed", "shown"), [(False, "tables\n"), (True, '{\n  "a": 1\n}\n')])
def test_it_is_printed_in_place_of_the_tables(is_printed: bool, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    with json_output(None, is_printed=is_printed, inputs=(), overwrite=False) as output:
        output.tree = {"a": 1}
    output.show(console(), lambda: print("tables"))
    assert capsys.readouterr().out == shown


def test_it_is_written_beside_the_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.json"
    with json_output(path, is_printed=False, inputs=(), overwrite=False) as output:
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
        json_output(path, is_printed=False, inputs=[path], overwrite=True),
    ):
        pass
    assert path.read_text() == "{}"


def test_a_command_that_fails_writes_none(tmp_path: Path) -> None:
    with (
        pytest.raises(LidcamError),
        json_output(tmp_path / "a.json", is_printed=False, inputs=(), overwrite=False),
    ):
        raise LidcamError("bad")
    assert list(tmp_path.iterdir()) == []
