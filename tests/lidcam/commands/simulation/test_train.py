"""`lidcam train clusters`, as far as it goes without training."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from lidcam.commands import app
from pipeline.core.errors import OutputError


@pytest.mark.parametrize("name", ["mine.npz", "mine.md"])
def test_what_is_there_stays(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(app, ["train", "clusters", "--out", str(tmp_path / "mine.npz")])
    assert isinstance(done.exception, OutputError)
    assert f"{name}: exists; choose another name" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
