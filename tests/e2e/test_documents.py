"""Every command of the documents and of the help texts is run, beside files of the names that they use.

A command that names a file which is not among `STAND_INS` fails here: add it there. What cannot be run is in
`EXCEPTIONS`, with the reason.
"""

import io
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from builders import write_mcap
from captures import capture_of, pcap
from command import called, shell
from document_commands import commands_of_help, commands_of_pages, pages
from helpers import CROSSING, ROOT, SANDBOX
from licences import PYPROJECT
from onnx_files import write_yolox
from pillar_files import write_pillars
from range_server import range_server
from velodyne import random_packets

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.detectors.cluster.network import EMBEDDED
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS
from lidcam.readers.open import open_recording

SCENARIOS = ROOT / "config" / "scenarios"

EXCEPTIONS = {
    r"pip install ": "needs an index: test_wheel installs the wheel, and the extras are looked up below",
    r"make ": "continuous integration calls demo and test; that the others exist is looked up below",
    r"apt-get ": "needs root and Debian",
    r"rerun ": "opens a window",
    r"python benchmarks/": "takes minutes, writes a page of the documents, or needs frames that nobody may hand on",
    r"lidcam view ": "opens a window: tests/lidcam/cli/test_view.py opens others in its place",
    r"lidcam fetch ": "needs the internet: tests/lidcam/networks fetches from a server on this machine",
    r"lidcam demo\b": "make demo, which the gate needs, runs it",
    r"lidcam (train|adapt) ": "takes minutes: tests/lidcam/training learns from a few worlds",
    r".*s3://": "needs a bucket: test_object_store has one on this machine",
    r"lidcam evaluate .*--truth dataset/": "needs a result of one lidar: tests/readers/truth reads such labels",
    r"lidcam batch .*--(engine ray|address) ": "needs a cluster: tests/lidcam/batches/test_ray.py starts one",
    r".*--(install|show)-completion": "asks which shell it is called from: test_calling does that",
}

SLOW = r"lidcam[- ](process|report|batch|drive) |lidcam simulate (random|vehicle|crossing) |.* --check|python "
"""Commands that take seconds even if shortened."""

INCOMPLETE = {"lidcam inspect broken.bag --repair whole.mcap", "lidcam inspect drive.bag --rig original"}
"""Commands that end with 3 beside these files, as their pages say."""

PLACEHOLDERS = {"SCENARIO": "sandbox", "OUT": "out.bag", "FOLDER": "folder", "KEY": "sync.slop_s"}


def recorded() -> list[RawMessage]:
    with open_recording([CROSSING]) as recording:
        return list(recording.messages())


def part(number: int, path: Path) -> None:
    messages = recorded()
    middle = len(messages) // 2
    write_mcap(path, messages[middle:] if number else messages[:middle])


def detected(path: Path) -> None:
    """The sample with the boxes of a 3D detector beside it, as the recording's own truth has them."""
    truth = [one for one in recorded() if one.topic == "/ground_truth/objects"]
    boxes = [one._replace(channel=replace(one.channel, topic="/perception/centerpoint/objects")) for one in truth]
    write_mcap(path, sorted([*recorded(), *boxes], key=lambda one: one.log_time_ns))


def folder(path: Path) -> None:
    path.mkdir()
    (path / CROSSING.name).symlink_to(CROSSING)


def capture(path: Path) -> None:
    path.write_bytes(pcap(capture_of(*random_packets("VLP-16", packets=170, start=0))))


def network(path: Path) -> None:
    write_yolox(path, np.zeros((84, 85), np.float32), size_px=(64, 64))


def fetched(folder: Path) -> None:
    (folder / "lidcam" / "networks").mkdir(parents=True)
    network(folder / "lidcam" / "networks" / "yolox_nano.onnx")


def pillar_network(path: Path) -> None:
    write_pillars(path, np.full((1 + BOX_NUMBERS, 32, 32), -9, np.float32), [{"name": "car"}])


def rig(path: Path) -> None:
    assert called(path.parent, "inspect", SANDBOX, "--write-rig", path, "-q").code == 0


def camchain(path: Path) -> None:
    path.write_text(
        "cam0: {camera_model: pinhole, intrinsics: [504.8, 504.8, 320.5, 240.5], distortion_model: none, "
        "resolution: [640, 480], rostopic: /image_raw_11}\n"
    )


def calibration(parent: str, child: str) -> Callable[[Path], object]:
    """Writes a file of Autoware's."""
    pose = "{x: 0.1, y: 0, z: 2, roll: 0, pitch: 0.01, yaw: -0.03}"
    return lambda path: path.write_text(f"{parent}: {{{child}: {pose}}}\n")


@cache
def result() -> bytes:
    """A small result: that of a command that every page may name."""
    with TemporaryDirectory() as home:
        path = Path(home) / "result.mcap"
        assert called(path.parent, "process", SANDBOX, path, "--duration", "0.2", "-q").code == 0
        return path.read_bytes()


def result_in_folder(path: Path) -> None:
    path.parent.mkdir()
    path.write_bytes(result())


STAND_INS: dict[str, Callable[[Path], object]] = {
    "drive.bag": lambda path: path.symlink_to(SANDBOX),
    "broken.bag": lambda path: path.write_bytes(SANDBOX.read_bytes()[:3_000_000]),
    "drive.lidcam/drive.mcap": result_in_folder,
    "golden.mcap": lambda path: path.write_bytes(result()),
    "new.mcap": lambda path: path.write_bytes(result()),
    "out.mcap": lambda path: path.write_bytes(result()),
    "@gate.txt": lambda path: path.with_name("gate.txt").write_text("fused.car.recall >= 0.5\n"),
    "drive.mcap": lambda path: path.symlink_to(CROSSING),
    "detected.mcap": detected,
    "drive.pcap": capture,
    "bag_folder": folder,
    "part_0.mcap": lambda path: part(0, path),
    "part_1.mcap": lambda path: part(1, path),
    "yolox-nano": lambda path: fetched(path.parent),
    "detector.onnx": network,
    "mine.onnx": pillar_network,
    "detect3d.weights=mine.npz": lambda path: shutil.copy(EMBEDDED, path.with_name("mine.npz")),
    "site.yaml": rig,
    "rig.yaml": rig,
    "fixed.yaml": rig,
    "mine.yaml": lambda path: shutil.copy(ROOT / "config" / "road.yaml", path),
    "camchain.yaml": camchain,
    "sensors_calibration.yaml": calibration("base_link", "sensor_kit_base_link"),
    "sensor_kit_calibration.yaml": calibration("sensor_kit_base_link", "velodyne_top_base_link"),
    "my.yaml": lambda path: shutil.copy(SCENARIOS / "sandbox.yaml", path),
}
"""Inputs by the names that the documents give them. An output of such a name has none."""


def all_commands() -> dict[str, str]:
    return commands_of_help() | commands_of_pages()


def exceptions_to(command: str) -> list[str]:
    return [pattern for pattern in EXCEPTIONS if re.match(pattern, command)]


def shortened(words: list[str]) -> list[str]:
    """The same command for less of a recording: the stand-ins last two seconds, and simulations take their time."""
    words = ["lidcam-process" if words[:2] == ["lidcam", "process"] else words[0], *words[1:]]
    if words[1:2] == ["process"]:
        del words[1]
    words = [word for word in words if word != "--view"]  # a window
    command = "process" if words[0] == "lidcam-process" else words[1]
    seconds = {"process": "0.2", "drive.bag": "0.2", "batch": "0.2", "simulate": "0.02", "drive": "0.02"}.get(command)
    if "--foxglove" in words:
        words[words.index("--foxglove") + 1] = "0"  # a port that is free
    if "--duration" in words:
        words[words.index("--duration") + 1] = seconds or ""
    elif seconds:
        words += ["--duration", seconds]
    if "--start" in words:
        words[words.index("--start") + 1] = "0.3"
    if command in {"simulate", "drive"}:
        words += ["--set", "cameras.*.width_px=80", "--set", "cameras.*.height_px=60"]
    if command == "simulate":
        words += ["--workers", "1"]
    return words


def outputs_of(words: list[str]) -> set[str]:
    """Names of the files that a command writes."""
    named = {after for option, after in pairwise(words) if option in {"--write-rig", "--repair", "--rerun"}}
    redirected = {after for sign, after in pairwise(words) if sign == ">"}
    made = {"process": ["out.mcap"], "simulate": words[3:4], "drive": words[3:4]}
    return named | redirected | set(made.get("process" if words[0] == "lidcam-process" else words[1], []))


def said(command: str) -> frozenset[str]:
    """What a command says, whatever it calls its outputs."""
    words = shortened(shlex.split(command))
    return frozenset(Path(word).suffix if word in outputs_of(words) else word for word in words)


def distinct(commands: list[str]) -> list[str]:
    """The commands of which no other says all and more; they are run for one time."""
    words = {one: said(one) for one in commands}
    return [
        one
        for row, one in enumerate(commands)
        if not any(words[one] <= words[other] for other in commands[:row])
        and not any(words[one] < words[other] for other in commands[row + 1 :])
    ]


RUNNABLE = [command for command in all_commands() if not exceptions_to(command)]
COMMANDS = [*distinct([one for one in RUNNABLE if one not in INCOMPLETE]), *sorted(INCOMPLETE)]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with range_server({"/drive.mcap": CROSSING.read_bytes()}) as server:
        yield server.url


@pytest.mark.parametrize(
    "command", [pytest.param(one, marks=[pytest.mark.slow] * bool(re.match(SLOW, one))) for one in COMMANDS]
)
def test_commands_do_what_they_say(command: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [PLACEHOLDERS.get(word, word) for word in shlex.split(command.replace("https://host", url))]
    for name in set(words) & (STAND_INS.keys() - outputs_of(words)):
        STAND_INS[name](tmp_path / name)
    (tmp_path / "bags").mkdir()
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "stdin", io.StringIO("wo"))
    signs = [place for place, word in enumerate(words) if word in {"|", ">"}]
    if signs:
        program = Path(sys.executable).with_name(words[0])
        rest = shlex.join(words[signs[0] + 1 :])
        line = f"{program} {shlex.join(shortened(words[: signs[0]])[1:])} {words[signs[0]]} {rest}"
        run = shell(line, tmp_path)
    elif words[0] == "python":
        run = shell(shlex.join([sys.executable, *words[1:]]), ROOT)
    else:
        name, *arguments = shortened(words)
        run = called(tmp_path, *arguments, program=name)
    assert run.code == (3 if command in INCOMPLETE else 0), f"{all_commands()[command]}: {command}\n{run.err}"
    assert run.out or "wrote" in run.err or ">" in words


def test_pages_of_commands_that_end_with_3_say_so() -> None:
    for command in INCOMPLETE:
        (page,) = (page for page in pages() if page.name == commands_of_pages()[command])
        before, _, after = page.read_text(encoding="utf-8").partition(command)
        assert "exit code 3" in before[-800:] + after[:800], command


def test_every_kind_of_command_is_there_and_every_exception_is_one() -> None:
    kinds = {command.split(" ")[1] for command in COMMANDS if command.startswith("lidcam ")}
    assert kinds >= {"process", "inspect", "evaluate", "compare", "simulate", "drive", "config"}
    used = [pattern for command in all_commands() for pattern in exceptions_to(command)]
    assert set(used) == set(EXCEPTIONS)


def test_extras_and_targets_of_make_exist() -> None:
    text = "\n".join([*all_commands(), (ROOT / "README.md").read_text(encoding="utf-8")])
    extras = {extra for names in re.findall(r"lidcam\[([\w,]+)\]", text) for extra in names.split(",")}
    assert (
        {"sim", "train", "foxglove", "video", "http", "s3"}
        <= extras
        <= set(PYPROJECT["project"]["optional-dependencies"])
    )
    targets = re.findall(r"^(\w[\w/.]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {target for command in all_commands() for target in re.findall(r"^make ([\w/.]+)", command)} <= {*targets}
