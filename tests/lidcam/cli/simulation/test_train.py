"""`lidcam train`, as far as it goes without training."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from lidcam.cli import app
from lidcam.pipeline.core.errors import ConfigError, ModelError, OutputError, RecordingError

pytest.importorskip("torch", reason="needs the extra train")


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("clusters", "--out", "mine.npz"), "mine.npz"),
        (("pillars", "--steps", "1", "--out", "mine.onnx"), "mine.onnx"),
        (("pillars", "--steps", "1", "--out", "mine.onnx"), "mine.ckpt"),
        (("convert", "net.pth", "--out", "mine.onnx"), "mine.onnx"),
    ],
)
def test_what_is_there_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(app, ["train", *command])
    assert isinstance(done.exception, OutputError)
    assert f"{name}: exists; " in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("option", ["--recordings", "--from"])
def test_the_state_of_a_training_stays_until_another_begins(tmp_path: Path, option: str) -> None:
    state = tmp_path / "mine.ckpt"
    state.write_text("mine", encoding="utf-8")
    command = ["pillars", "--steps", "1", "--out", str(tmp_path / "mine.onnx"), "--overwrite"]
    done = CliRunner().invoke(app, ["train", *command, option, str(tmp_path / "none")])
    assert isinstance(done.exception, (RecordingError, ModelError))
    assert state.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("recording", "command", "expected"),
    [
        ("sandbox.bag", ["clusters", "--out", "mine.npz"], "road users of full size, as of --config road"),
        (
            "crossing.mcap",
            ["pillars", "--steps", "1", "--out", "mine.onnx", "--family", "sandbox"],
            "model cars, as of --config sandbox",
        ),
    ],
)
def test_recordings_of_other_sizes_are_not_learned_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recording: str, command: list[str], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    bags = Path(__file__).resolve().parents[4] / "bags"
    done = CliRunner().invoke(app, ["train", *command, "--recordings", str(bags / recording)])
    assert isinstance(done.exception, ConfigError)
    assert f"expected {expected}" in str(done.exception)
    assert "found the classes car" in str(done.exception)
    assert not [*tmp_path.iterdir()]
