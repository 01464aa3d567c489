"""Where a command puts its JSON."""

import json
from pathlib import Path

import pytest

from lidcam.cli.json_output import json_output
from lidcam.pipeline.core.errors import LidcamError, OutputError


def test_it_has_its_name_when_the_command_has_done_its_work(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with json_output(path, inputs=(), overwrite=False) as write_json:
        write_json({"a": "\x1b"})
        assert not path.exists()
    text = path.read_text()
    assert text.endswith("}\n")
    assert "\x1b" not in text
    assert json.loads(text)["a"] == "\x1b"


def test_a_command_that_fails_writes_none(tmp_path: Path) -> None:
    with (
        pytest.raises(LidcamError),
        json_output(tmp_path / "a.json", inputs=(), overwrite=False),
    ):
        raise LidcamError("bad")
    assert list(tmp_path.iterdir()) == []


def test_only_what_an_earlier_run_wrote_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for number, overwrite in ((1, False), (2, False), (3, True)):
        with json_output(path, inputs=(), overwrite=overwrite) as write_json:
            write_json({"a": number})
        assert json.loads(path.read_text())["a"] == number
    path.write_text('{"mine": 1}\n')
    with pytest.raises(OutputError, match="replace it with --overwrite"), json_output(path, inputs=(), overwrite=False):
        pass
    assert path.read_text() == '{"mine": 1}\n'
