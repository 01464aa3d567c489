"""What people meet on the way: help, interrupted runs, outputs that would destroy inputs, logs and pipes."""

import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
import yaml
from command import Lidcam
from results import fused_objects

PROGRAM = Path(sys.executable).with_name("lidcam-process")


@pytest.mark.parametrize("command", ["process", "inspect", "evaluate"])
def test_examples_stand_on_lines_of_their_own(lidcam: Lidcam, command: str) -> None:
    run = lidcam(command, "--help")
    assert run.code == 0
    lines = run.out.splitlines()
    examples = lines[lines.index("  Examples:") + 1 :]
    assert len(examples) >= 3
    assert all(line.startswith("    lidcam") for line in examples)
    assert all(len(line) <= 80 for line in lines)


def test_both_programs_tell_their_version(lidcam: Lidcam) -> None:
    done = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == lidcam("--version").out
    assert done.stdout.startswith("lidcam ")


@pytest.mark.parametrize(
    ("number", "code", "told"),
    [
        (signal.SIGINT, 130, "lidcam: interrupted"),
        (signal.SIGTERM, 143, "lidcam: terminated"),
        (signal.SIGHUP, 129, "lidcam: ended: its terminal was closed"),
    ],
)
def test_a_run_that_is_interrupted_leaves_nothing(
    sandbox: Path, sandbox_config: Path, tmp_path: Path, number: signal.Signals, code: int, told: str
) -> None:
    command = [PROGRAM, sandbox, tmp_path / "out.mcap", "--config", sandbox_config, "--rerun", tmp_path / "out.rrd"]
    command += ["--set", "combine.ground.iterations=20000"]  # so that it is still at work
    with subprocess.Popen(
        [str(part) for part in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Who runs the tests may ignore it, as a shell does with Ctrl-C in the background, and nohup with SIGHUP.
        preexec_fn=partial(signal.signal, number, signal.SIG_DFL),
    ) as run:
        until = time.monotonic() + 60
        while not list(tmp_path.glob(".out.rrd.lidcam-*/out.rrd")):
            assert run.poll() is None, run.communicate()
            assert time.monotonic() < until
            time.sleep(0.02)
        run.send_signal(number)
        _, err = run.communicate(timeout=60)
    assert run.returncode == code
    assert err.splitlines()[-1] == told
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", ["inf", "nan", "1e300", "0"])
def test_durations_that_are_none_are_wrong_usage(lidcam: Lidcam, sandbox: Path, tmp_path: Path, value: str) -> None:
    run = lidcam("process", sandbox, tmp_path / "out.mcap", "--duration", value)
    assert run.code == 2
    assert "--duration" in run.err
    assert list(tmp_path.iterdir()) == []


def test_json_is_one_document(lidcam: Lidcam, sandbox: Path, tmp_path: Path) -> None:
    run = lidcam("process", sandbox, tmp_path / "out.mcap", "--json", "--print-matches")
    assert run.code == 2
    assert "--json" in run.err
    report = json.loads(lidcam("inspect", sandbox, "--json").out)
    assert {sensor["sensor"] for sensor in report["sensors"]} > {"velodyne1", "cam11"}


def test_no_output_replaces_a_part_of_the_recording(
    lidcam: Lidcam, sandbox: Path, sandbox_config: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    recording = folder / "part.mcap"
    assert lidcam("process", sandbox, recording, "--config", sandbox_config, "--duration", "0.3").code == 0
    before = recording.read_bytes()
    link = tmp_path / "link.mcap"
    link.symlink_to(recording)
    for output in (recording, link):
        run = lidcam("process", folder, output)
        assert run.code == 1
        assert "choose another name" in run.error_line
    run = lidcam("inspect", recording, "--write-rig", recording)
    assert run.code == 1
    assert "choose another name" in run.error_line
    assert recording.read_bytes() == before


def test_a_forgotten_output_does_not_cost_a_recording(lidcam: Lidcam, crossing: Path, tmp_path: Path) -> None:
    for number in (0, 1):
        (tmp_path / f"rec_{number}.mcap").write_bytes(crossing.read_bytes())
    before = (tmp_path / "rec_1.mcap").read_bytes()
    run = lidcam("process", *sorted(tmp_path.glob("rec_*.mcap")))
    assert run.code == 1
    assert "rec_1.mcap: exists and is no result of an earlier run" in run.error_line
    assert (tmp_path / "rec_1.mcap").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rec_0.mcap", "rec_1.mcap"]


def test_two_outputs_are_two_files(lidcam: Lidcam, sandbox: Path, tmp_path: Path) -> None:
    (tmp_path / "out.rrd").symlink_to(tmp_path / "out.mcap")
    run = lidcam("process", sandbox, tmp_path / "out.mcap", "--rerun", tmp_path / "out.rrd")
    assert run.code == 1
    assert "out.rrd: is the same file as" in run.error_line


def test_names_are_printed_as_they_are(lidcam: Lidcam, sandbox: Path, tmp_path: Path) -> None:
    out = tmp_path / "a[bold]b.mcap"  # markup to the library that prints
    run = lidcam("process", sandbox, out, "--duration", "0.3")
    assert run.code == 0, run.err
    assert str(out) in run.out
    assert all(line == line.rstrip() for line in run.out.splitlines())


def test_a_written_rig_gives_the_same_objects(
    lidcam: Lidcam, sandbox: Path, sandbox_config: Path, tmp_path: Path
) -> None:
    rig, found, given = tmp_path / "rig.yaml", tmp_path / "found.mcap", tmp_path / "given.mcap"
    assert lidcam("inspect", sandbox, "--write-rig", rig).code == 0
    options = ("--config", sandbox_config, "--duration", "0.5")
    assert lidcam("process", sandbox, found, *options).code == 0
    assert lidcam("process", sandbox, given, *options, "--rig", rig).code == 0
    assert fused_objects(given) == fused_objects(found)
    assert any(fused_objects(given).values())


def test_a_rig_in_two_files_gives_the_same_bytes(
    lidcam: Lidcam, sandbox: Path, sandbox_config: Path, tmp_path: Path
) -> None:
    rig, one, two = tmp_path / "rig.yaml", tmp_path / "one.mcap", tmp_path / "two.mcap"
    assert lidcam("inspect", sandbox, "--write-rig", rig).code == 0
    tree = yaml.safe_load(rig.read_text())
    lenses = {
        name: {key: camera.pop(key) for key in ("K", "distortion_model", "distortion")}
        for name, camera in tree["cameras"].items()
    }
    (tmp_path / "poses.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    (tmp_path / "lenses.yaml").write_text(yaml.safe_dump({"cameras": lenses}, sort_keys=False))
    options = ("--config", sandbox_config, "--duration", "0.3")
    assert lidcam("process", sandbox, one, *options, "--rig", rig).code == 0
    parts = ("--rig", tmp_path / "poses.yaml", "--rig", tmp_path / "lenses.yaml")
    assert lidcam("process", sandbox, two, *options, *parts).code == 0
    assert one.read_bytes() == two.read_bytes()
    run = lidcam("inspect", sandbox, *parts, "--rig", "no_rig")
    assert run.code == 1
    assert "no_rig: expected a preset (original) or a rig file, found neither" in run.error_line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_standard_output_on_a_full_disk_is_an_error_in_one_line(sandbox: Path) -> None:
    with Path("/dev/full").open("w") as full:
        command = [str(PROGRAM.with_name("lidcam")), "inspect", str(sandbox)]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "lidcam: error: standard output: No space left on device\n"
