"""`lidcam train` and `lidcam adapt`, as far as they go without training."""

# without torch the file is skipped before it imports what needs it

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import BAGS, SANDBOX
from typer.testing import CliRunner

pytest.importorskip("torch", reason="needs the extra train")

from lidcam.cli import app
from lidcam.pipeline.core.errors import ConfigError, LidcamError, ModelError, OutputError, RecordingError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.training import recordings
from lidcam.training.labelled import WORLDS, Recordings
from lidcam.training.pillars import train
from lidcam.training.pillars.fit import Checkpoint
from lidcam.training.pillars.train import Judged, Trained


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("train", "clusters", "--out", "mine.npz"), "mine.npz"),
        (("train", "pillars", "--steps", "1", "--out", "mine.onnx"), "mine.onnx"),
        (("train", "pillars", "--steps", "1", "--out", "mine.onnx"), "mine.ckpt"),
        (("adapt", "drive.mcap", "--out", "mine.onnx"), "mine.ckpt"),
        (("train", "convert", "net.pth", "--out", "mine.onnx"), "mine.onnx"),
    ],
)
def test_what_is_there_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("mine", encoding="utf-8")
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, OutputError)
    assert f"{name}: exists; " in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("option", ["--config", "--set", "--rig"])
@pytest.mark.parametrize("network", ["clusters --out a.npz", "pillars --steps 1 --out a.onnx"])
def test_how_to_read_recordings_needs_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, network: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["train", *network.split(), option, "sandbox"])
    assert done.exit_code == 2
    assert "give --recordings" in " ".join(done.output.replace("│", " ").split())


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
    done = CliRunner().invoke(app, ["train", *command, "--recordings", str(BAGS / recording)])
    assert isinstance(done.exception, ConfigError)
    assert f"expected {expected}" in str(done.exception)
    assert "found the classes car" in str(done.exception)
    assert not [*tmp_path.iterdir()]


def found(*is_right: bool) -> Judged:
    """Boxes, likelier ones first, of two objects."""
    count = len(is_right)
    errors = np.zeros((count, 3))
    return Judged(np.linspace(1, 0, count), np.zeros(count, np.int64), np.array(is_right), errors, np.array([2]))


BEFORE = found(True, False, True)


@pytest.mark.parametrize(
    ("before", "after", "error"),
    [
        (BEFORE, found(True, True), None),
        (BEFORE, BEFORE, "a.bag: nothing gained: average precision in the held-out frames 0.833 before, 0.8"),
        (BEFORE, found(True), "0.833 before, 0.500 after; no network written"),
        (BEFORE, found(), "0.833 before, 0.000 after; no network written"),
        (BEFORE._replace(objects=np.array([0])), BEFORE, "a.bag: expected objects of sure tracks in the last tenth"),
    ],
    ids=["better", "as good", "worse", "nothing found", "nothing to find"],
)
def test_only_a_better_network_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: Judged, after: Judged, error: str | None
) -> None:
    def trained(
        checkpoint: Checkpoint, out: Path, steps: int, *, begun: Callable[[object], object], **_: object
    ) -> Trained:
        assert (checkpoint.source.worlds, Path(checkpoint.begin).name, steps) == ("sandbox", "sandbox.onnx", 9)
        assert checkpoint.source.has_worlds
        begun({"recordings": before})
        out.write_bytes(b"network")
        return Trained("# Card\n", *({"recordings": one, WORLDS: found(True)} for one in (before, after)))

    def read(_: object, __: Path, *, check: Callable[[Config], object], own_labels: bool, **___: object) -> Recordings:
        check(load_config("sandbox"))
        assert own_labels
        return Recordings((), (), (), tmp_path, ())

    monkeypatch.setattr(train, "train_pillars", trained)
    monkeypatch.setattr(recordings, "read_recordings", read)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["adapt", "a.bag", "--out", "mine.onnx", "--steps", "9"])
    if error is None:
        assert done.output.splitlines()[:2] == [
            "average precision in held-out frames, measured against their tracks: 0.833 before, 1.000 after",
            "average precision in simulated worlds: 0.500 before, 0.500 after",
        ]
        assert (tmp_path / "mine.onnx").read_bytes() == b"network"
        assert (tmp_path / "mine.md").read_text(encoding="utf-8") == "# Card\n"
    else:
        assert isinstance(done.exception, LidcamError)
        assert error in str(done.exception)
        assert not [*tmp_path.iterdir()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "error"),
    [
        (
            ["detect3d.method=cluster"],
            "expected recordings that use the same 3D network, found none for the classes car;",
        ),
        ([], "sandbox.bag: nothing to gain: the network already finds every object in the held-out frames, and"),
    ],
)
def test_what_is_not_adapted_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: list[str], error: str
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [part for one in settings for part in ("--set", one)]
    done = CliRunner().invoke(app, ["adapt", str(SANDBOX), "--out", "mine.onnx", "--workers", "1", *given])
    assert isinstance(done.exception, LidcamError)
    assert error in str(done.exception)
    assert not [*tmp_path.iterdir()]
