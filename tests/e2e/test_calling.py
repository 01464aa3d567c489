"""Calling the program by hand and from scripts: terminals, pipes, logs, quiet, strict, completion."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command import Lidcam
from mcap.reader import make_reader

PROGRAM = Path(sys.executable).with_name("lidcam")
PART = ("--duration", "0.4")


def shell(command: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, **environment}
    return subprocess.run(
        ["bash", "-c", command], cwd=cwd, env=variables, capture_output=True, text=True, timeout=120, check=False
    )


def frames_in(path: Path) -> int:
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    names = {channel.id: channel.topic for channel in summary.channels.values()}
    counts = {names[id_]: count for id_, count in summary.statistics.channel_message_counts.items()}
    return counts["/fused/detections"]


@pytest.mark.parametrize("option", ["--print-detections", "--json"])
def test_a_reader_that_leaves_does_not_end_the_run(
    option: str, sandbox: Path, sandbox_config: Path, tmp_path: Path
) -> None:
    line = f"{PROGRAM} process {sandbox} out.mcap --config {sandbox_config} {option} | head -n 1; "
    line += "echo ${PIPESTATUS[0]}"
    done = shell(line, tmp_path)
    assert not [line for line in done.stderr.splitlines() if " frames, " not in line]  # progress, on a slow machine
    _, code = done.stdout.splitlines()
    assert code == "0"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.foxglove.json", "out.mcap"]
    assert frames_in(tmp_path / "out.mcap") == 20


@pytest.mark.traced_processes
def test_neither_does_one_of_an_inspection(sandbox: Path, tmp_path: Path) -> None:
    done = shell(f"{PROGRAM} inspect {sandbox} | head -n 1; echo ${{PIPESTATUS[0]}}", tmp_path)
    assert done.stderr == ""
    assert done.stdout.splitlines()[1:] == ["0"]


def test_neither_does_one_of_errors(sandbox: Path, tmp_path: Path) -> None:
    done = shell(f"{PROGRAM} process {sandbox} out.mcap -v {shlex.join(PART)} 2>&1 | head -n 1", tmp_path)
    assert done.stdout.startswith("lidcam: lidcam ")
    assert frames_in(tmp_path / "out.mcap") >= 2


@pytest.mark.skipif(shutil.which("script") is None, reason="needs script of util-linux")
def test_tables_fit_the_terminal(sandbox: Path, tmp_path: Path) -> None:
    command = f"{PROGRAM} inspect {sandbox}"
    piped = shell(command, tmp_path).stdout
    assert max(map(len, piped.splitlines())) > 120  # there a row is a line
    done = shell(f"script -qec '{command}' /dev/null", tmp_path, COLUMNS="80", TERM="dumb")
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    assert max(map(len, lines)) <= 80
    numbers = re.compile(r"(?<= )\d+(?:\.\d+)?(?= |$)")
    rows = piped[piped.index("topics") : piped.index("site frame")]
    shown = "\n".join(lines)
    shown = shown[shown.index("topics") : shown.index("site frame")]
    assert numbers.findall(shown) == numbers.findall(rows)


@pytest.mark.skipif(shutil.which("script") is None, reason="needs script of util-linux")
@pytest.mark.parametrize(("option", "has_bar"), [("--json", True), ("--quiet", False), ("--print-matches", False)])
def test_a_bar_on_a_terminal(sandbox: Path, tmp_path: Path, option: str, has_bar: bool) -> None:
    command = f"{PROGRAM} process {sandbox} out.mcap {shlex.join(PART)} {option}"
    done = shell(f"script -qec '{command}' /dev/null", tmp_path, COLUMNS="100", TERM="xterm")
    assert done.returncode == 0, done.stdout
    assert bool(re.search(r"\d frames, [\d.]+ a second, \d+ objects, \d+ dropped", done.stdout)) == has_bar


def test_quiet_is_the_result_alone(lidcam: Lidcam, sandbox: Path, tmp_path: Path) -> None:
    told = lidcam("inspect", sandbox, "--write-rig", tmp_path / "rig.yaml")
    assert told.err == f"wrote {tmp_path / 'rig.yaml'}\n"
    quiet = lidcam("inspect", sandbox, "--write-rig", tmp_path / "rig.yaml", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, told.out, "")
    failed = lidcam("inspect", tmp_path / "missing.bag", "--quiet")
    assert failed.code == 1
    assert "missing.bag" in failed.error_line


def test_verbose_and_a_log_file(lidcam: Lidcam, sandbox: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    run = lidcam("process", sandbox, tmp_path / "out.mcap", *PART, "-v", "--log-file", log)
    assert run.code == 0
    assert "lidcam.run: frame 1, 1700000000100859904 ns: 19 topics" in run.err
    assert lidcam("process", sandbox, tmp_path / "no_folder" / "out.mcap", "-q", "--log-file", log).code == 1
    lines = log.read_text(encoding="utf-8").splitlines()
    assert all(re.match(r"20[0-9-]{8}T[0-9:]{8}\.\d{3}Z (DEBUG|INFO|WARNING|ERROR) ", line) for line in lines)
    assert sum("frame 1, " in line for line in lines) == 1
    assert any("done: " in line for line in lines)
    assert "ERROR" in lines[-1]
    assert "no_folder does not exist" in lines[-1]


@pytest.mark.parametrize("arguments", [("-v", "-q"), ("--log-file", "drive.bag")])
def test_wrong_usage_of_the_log(lidcam: Lidcam, sandbox: Path, arguments: tuple[str, ...]) -> None:
    run = lidcam("inspect", sandbox, *arguments)
    assert run.code == 2
    assert "expected" in run.err


@pytest.mark.parametrize(
    "command", [(), ("process",), ("inspect",), ("evaluate",), ("simulate",), ("drive",), ("config", "show")]
)
def test_short_help(lidcam: Lidcam, command: tuple[str, ...]) -> None:
    short = lidcam(*command, "-h")
    assert short.code == 0
    assert short.out == lidcam(*command, "--help").out
    assert all(len(line) <= 80 for line in short.out.splitlines())
    assert not command or "--log-file FILE" in short.out


def test_a_path_is_a_file_even_if_a_preset_has_its_name(sandbox: Path, tmp_path: Path) -> None:
    (tmp_path / "road").write_text("fuse: {min_scor: 0.1}", encoding="utf-8")
    done = shell(f"{PROGRAM} inspect {sandbox} --config ./road", tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("lidcam: error: ./road: unknown key 'fuse.min_scor': did you mean 'fuse.min_score'?")


@pytest.mark.parametrize("command", [(), ("config",)])
def test_help_says_in_whole_sentences_what_commands_do(lidcam: Lidcam, command: tuple[str, ...]) -> None:
    lines = lidcam(*command, "-h").out.partition("Commands:\n")[2].splitlines()
    assert len(lines) >= 3
    assert not [line for line in lines if line.endswith("...")]


def test_strict(lidcam: Lidcam, sandbox: Path, sandbox_config: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    options = ("--config", sandbox_config, *PART, "--strict")
    assert lidcam("process", sandbox, out, *options).code == 0
    cut = tmp_path / "cut.bag"
    cut.write_bytes(sandbox.read_bytes()[:3_000_000])
    run = lidcam("process", cut, out, *options)
    assert run.code == 1
    assert run.err.splitlines()[-1].startswith(f"lidcam: error: --strict: {cut}: 1 damaged part")
    assert "the outputs are complete" in run.err
    assert frames_in(out) >= 2
    assert "run\n" in run.out  # the tables are printed all the same
    alone = lidcam("process", sandbox, out, "--max-dropped", "1")
    assert alone.code == 2
    assert "--strict" in alone.err


@pytest.mark.parametrize("shell_name", ["bash", "zsh", "fish"])
def test_completion_scripts(shell_name: str, tmp_path: Path) -> None:
    for program in ("lidcam", "lidcam-process"):
        variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
        done = shell(f"{PROGRAM.with_name(program)}", tmp_path, **{variable: f"source_{shell_name}"})
        assert done.returncode == 0, done.stderr
        assert f"complete_{shell_name}" in done.stdout


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("lidcam in", ["inspect"]),
        ("lidcam simulate s", ["sandbox"]),
        ("lidcam process --max", ["--max-dropped"]),
        ("lidcam process --on-bad-message ", ["skip", "fail"]),
    ],
)
def test_the_shell_completes(line: str, found: list[str], tmp_path: Path) -> None:
    words = line.split(" ")
    done = shell(
        str(PROGRAM), tmp_path, _LIDCAM_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(words) - 1)
    )
    assert done.stdout.split() == found
    assert done.stderr == ""


@pytest.mark.traced_processes
def test_completion_is_installed_for_the_shell(tmp_path: Path) -> None:
    # The shell is the parent process: bash that has only one command to run would be replaced by it.
    done = shell(f"{PROGRAM} --install-completion; exit $?", tmp_path, HOME=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "installed" in done.stdout
    assert any("lidcam" in path.name for path in tmp_path.rglob("*") if path.is_file())


@pytest.mark.parametrize("folder", ["file", "file/inside"])
def test_the_demo_needs_a_folder(lidcam: Lidcam, tmp_path: Path, folder: str) -> None:
    (tmp_path / "file").touch()
    run = lidcam("demo", tmp_path / folder)
    assert run.code == 1
    assert "expected a folder to write to" in run.error_line


def test_the_demo_prints_what_the_readme_shows(lidcam: Lidcam, tmp_path: Path) -> None:
    readme = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
    table = readme.split("and prints what it found:\n\n```\n")[1].split("...\n```")[0]
    assert table.startswith("objects")
    run = lidcam("demo", tmp_path / "a" / "b", "-q")
    assert (run.code, run.err) == (0, "")
    assert frames_in(tmp_path / "a" / "b" / "sandbox.mcap") == 20
    assert run.out.startswith(table)
    _, shown = run.out.split("\nLook at it:\n")
    assert f"rerun {tmp_path}/a/b/sandbox.rrd" in shown
    assert f"inspect {tmp_path}/a/b/sandbox.bag" in shown
