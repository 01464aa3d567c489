"""`lidcam train`, as far as it goes without training."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from lidcam.commands import app
from pipeline.core.errors import OutputError


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("clusters", "--out", "mine.npz"), "mine.npz"),
        (("clusters", "--out", "mine.npz"), "mine.md"),
        (("pillars", "--steps", "1", "--out", "mine.onnx"), "mine.onnx"),
        (("pillars", "--steps", "1", "--out", "mine.onnx"), "mine.md"),
        (("pillars", "--steps", "1", "--out", "mine.onnx"), "mine.ckpt"),
        (("images", "--steps", "1", "--out", "mine.onnx"), "mine.onnx"),
    ],
)
def test_what_is_there_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if command[0] != "clusters":
        pytest.importorskip("torch", reason="needs the extra train")
    (tmp_path / name).write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(app, ["train", *command])
    assert isinstance(done.exception, OutputError)
    assert f"{name}: exists; " in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
