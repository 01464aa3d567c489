"""Calling the program by hand and from scripts: help, terminals, pipes, logs, quiet, strict, completion."""

import re
import shutil
import sys
from pathlib import Path

import pytest
from builders import write_mcap
from command import Lidcam, shell
from helpers import CLUSTERS, SANDBOX
from results import topics_of
from small_drive import small_drive

PROGRAM = Path(sys.executable).with_name("lidcam")
PART = ("--duration", "0.3", "--set", CLUSTERS)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    write_mcap(path := tmp_path_factory.mktemp("drive") / "drive.mcap", small_drive("cdr"))
    return path


@pytest.mark.parametrize(
    "command",
    [
        "process {sandbox} out.mcap --duration 0.4 --print-detections",
        pytest.param("process {sandbox} out.mcap --duration 0.4 --verbose 2>&1", marks=pytest.mark.slow),
    ],
)
def test_a_reader_that_leaves_does_not_end_the_run(command: str, tmp_path: Path) -> None:
    line = f"{PROGRAM} {command.format(sandbox=SANDBOX)} | head -n 1 && echo ${{PIPESTATUS[0]}}"
    done = shell(line, tmp_path)
    assert not [line for line in done.err.splitlines() if " frames, " not in line]  # progress, on a slow machine
    assert done.out.splitlines()[1:] == ["0"]
    if "out.mcap" in command:
        assert sorted(path.name for path in tmp_path.iterdir()) == ["out.foxglove.json", "out.mcap"]
        assert topics_of(tmp_path / "out.mcap")["/fused/detections"][1] >= 2


@pytest.mark.skipif(shutil.which("script") is None, reason="needs script of util-linux")
@pytest.mark.parametrize(("option", "has_bar"), [("--json", True), ("--print-matches", False)])
def test_a_bar_on_a_terminal(drive: Path, tmp_path: Path, option: str, has_bar: bool) -> None:
    command = f"{PROGRAM} process {drive} out.mcap --set {CLUSTERS} {option}"
    done = shell(f"script -qec '{command}' /dev/null", tmp_path, COLUMNS="100", TERM="xterm")
    assert done.code == 0, done.out
    assert ("all frames written, finishing the outputs" in done.out) == has_bar  # what it ends with is always drawn


def test_quiet_is_the_result_alone(lidcam: Lidcam, tmp_path: Path) -> None:
    told = lidcam("inspect", SANDBOX, "--write-rig", tmp_path / "rig.yaml")
    assert told.err == f"wrote {tmp_path / 'rig.yaml'}\n"
    quiet = lidcam("inspect", SANDBOX, "--write-rig", tmp_path / "rig.yaml", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, told.out, "")
    failed = lidcam("inspect", tmp_path / "missing.bag", "--quiet")
    assert failed.code == 1
    assert "missing.bag" in failed.error_line


def test_verbose_and_a_log_file(lidcam: Lidcam, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    run = lidcam("process", SANDBOX, tmp_path / "out.mcap", *PART, "-v", "--log-file", log)
    assert run.code == 0
    assert f"lidcam: {SANDBOX}: 1677 messages of 62 topics" in run.err
    assert "lidcam.processing: frame 1, 1700000000100859904 ns: 19 topics" in run.err
    assert "\ntime\nstage" in run.out
    assert "\ntime\n" not in lidcam("process", SANDBOX, tmp_path / "out.mcap", *PART).out
    shown = lidcam("inspect", SANDBOX).out
    assert "other topics, listed with -v: /car1/* (8 topics), /car2/* (8 topics), /ground_truth/*" in shown
    assert "/car1/base_pose_ground_truth" in lidcam("inspect", SANDBOX, "-v").out
    assert lidcam("process", SANDBOX, log / "out.mcap", "-q", "--log-file", log).code == 1
    lines = log.read_text(encoding="utf-8").splitlines()
    assert all(re.match(r"20[0-9-]{8}T[0-9:]{8}\.\d{3}Z (DEBUG|INFO|WARNING|ERROR) ", line) for line in lines)
    assert sum("frame 1, " in line for line in lines) == 1
    assert any("done: " in line for line in lines)
    assert "ERROR" in lines[-1]
    assert "run.log/out.mcap: cannot be written" in lines[-1]


@pytest.mark.parametrize("command", ["", "process", "train pillars", "compare"])
def test_help_of_a_narrow_terminal(command: str, tmp_path: Path) -> None:
    text, _, _ = shell(f"{PROGRAM} {command} --help", tmp_path, COLUMNS="40").out.partition("  Examples:\n")
    assert "--help" in text
    assert not [line for line in text.splitlines() if len(line) > 40]


@pytest.mark.parametrize("command", ["", "process", "inspect", "evaluate", "drive", "config"])
def test_help(lidcam: Lidcam, command: str) -> None:
    done = lidcam(*command.split(), "-h")
    assert (done.code, done.out) == (0, lidcam(*command.split(), "--help").out)
    assert all(len(line) <= 80 for line in done.out.splitlines())
    commands = done.out.partition("Commands:\n")[2].splitlines()
    assert (len(commands) >= 3) == (command in {"", "config"})
    assert not [line for line in commands if line.endswith("...")], "whole sentences"
    examples = done.out.partition("  Examples:\n")[2].strip("\n").splitlines()
    assert all(line.startswith("    lidcam") for line in examples)
    assert len(examples) >= (3 if command in {"process", "inspect", "evaluate"} else 0)
    assert commands or "--log-file FILE" in done.out


@pytest.mark.parametrize(
    ("line", "found"), [("lidcam simulate s", ["sandbox"]), ("lidcam process --on-bad-message ", ["skip", "fail"])]
)
def test_the_shell_completes(line: str, found: list[str], tmp_path: Path) -> None:
    words = line.split(" ")
    done = shell(
        str(PROGRAM), tmp_path, _LIDCAM_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(words) - 1)
    )
    assert done.out.split() == found
    assert done.err == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_standard_output_on_a_full_disk_is_an_error_in_one_line(drive: Path, tmp_path: Path) -> None:
    done = shell(f"{PROGRAM} inspect {drive} > /dev/full", tmp_path)
    assert done.code == 1
    assert done.err == "lidcam: error: standard output: No space left on device\n"


@pytest.mark.parametrize(("kib", "mode"), [(10, "none"), (50, "offline")])
def test_outputs_on_a_full_disk_are_an_error_in_one_line(kib: int, mode: str, drive: Path, tmp_path: Path) -> None:
    """The size of a file is limited; coverage would write files, too, and Python keeps modules that are cut off."""
    (out := tmp_path / "out").mkdir()
    outputs = f"{out}/out.mcap --rerun {out}/out.rrd"
    line = f"ulimit -f {kib}; exec {PROGRAM} process {drive} {outputs} --set track.mode={mode} --set {CLUSTERS}"
    done = shell(f"unset ${{!COVERAGE*}}; {line}", tmp_path, PYTHONDONTWRITEBYTECODE="1")
    assert done.code == 1
    (error,) = [line for line in done.err.splitlines() if " frames, " not in line]
    if mode == "none":
        assert error.startswith(f"lidcam: error: {out}/out.")
        assert "cannot be written: File too large" in error
    else:
        assert error.startswith(f"lidcam: error: {out}: cannot buffer frames there: File too ")
    assert list(out.iterdir()) == []
