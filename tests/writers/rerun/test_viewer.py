"""The Rerun viewer, in place of which a program stands that fails."""

import subprocess
import sys
from typing import Any

import pytest
import rerun as rr

from lidcam.writers.rerun.viewer import RerunViewer


def test_a_run_goes_on_without_its_viewer(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    started: list[tuple[list[str], dict[str, str]]] = []
    popen = subprocess.Popen

    def stand_in(command: list[str], env: dict[str, str], **options: Any) -> "subprocess.Popen[bytes]":
        started.append((command, env))
        process = popen([sys.executable, "-c", "raise SystemExit(3)"], **options)
        process.wait()
        return process

    monkeypatch.setattr(subprocess, "Popen", stand_in)
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", lambda _: None)
    monkeypatch.setenv("DISPLAY", ":0")
    recording = rr.RecordingStream("test")
    shown = RerunViewer(recording)
    for _ in range(2):
        shown.check()
        recording.log("a", rr.TextLog("b"))
        shown.flush()
    shown.finish()
    assert caplog.messages == ["--view: the Rerun viewer shows no more, and the run goes on: it ended with 3"]
    ((command, env),) = started
    assert command[1:5] == ["-m", "rerun_cli", "--bind", "127.0.0.1"], "by itself it would listen to the network"
    assert env["CI"] == "true", "it sends no statistics"
