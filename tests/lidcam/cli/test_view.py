"""`lidcam view`: what it opens, and what it says where it cannot."""

import subprocess
import webbrowser
from pathlib import Path
from typing import Any

import pytest
from command import called
from helpers import ROOT


@pytest.fixture(autouse=True)
def results(tmp_path: Path) -> None:
    for name in ("out.rrd", "out.html", "out.mp4", "out.mcap", "out.csv", "out.foxglove.json"):
        (tmp_path / name).touch()


def test_what_there_is_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[object] = []

    def run(command: list[str], **_: Any) -> "subprocess.CompletedProcess[str]":
        opened.append(command[-1])
        return subprocess.CompletedProcess(command, len(opened) - 1)

    def browse(address: str) -> bool:
        opened.append(address)
        return len(opened) in {2, 3}

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(webbrowser, "open", browse)
    monkeypatch.setenv("DISPLAY", ":0")
    assert [called(tmp_path, "view", name).code for name in ("out.rrd", "out.html", "out.mp4")] == [0, 0, 0]
    assert opened == ["out.rrd", (tmp_path / "out.html").as_uri(), (tmp_path / "out.mp4").as_uri()]
    assert "the Rerun viewer ended with 3" in called(tmp_path, "view", "out.rrd").error_line
    assert "found no browser" in called(tmp_path, "view", "out.html").error_line


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("out.rrd", "out.rrd: expected a display for the Rerun viewer, found none (DISPLAY is not set); `rerun"),
        ("out.csv", "out.csv: expected a result of lidcam, which ends in .rrd, .html, .mp4 or .mcap"),
        ("none.rrd", "none.rrd: expected a result to open, found no such file"),
    ],
)
def test_what_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, told: str) -> None:
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    done = called(tmp_path, "view", name)
    assert done.code == 1
    assert told in done.error_line


def test_an_mcap_is_for_foxglove(tmp_path: Path) -> None:
    done = called(tmp_path, "view", "out.mcap")
    assert done.code == 0
    assert "Foxglove: open the .mcap, then Layouts, Import from file, out.foxglove.json" in done.out
    assert "Rerun opens it, too.\n" in done.out  # a recording has no objects
    result = ROOT / "tests" / "golden" / "sandbox.mcap"
    assert "Rerun opens it, too, but without the objects; use --rerun" in called(tmp_path, "view", str(result)).out
