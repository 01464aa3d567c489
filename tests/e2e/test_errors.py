"""Wrong input: one clear line, the right exit code, and no output left behind."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from builders import write_rosbag1
from command import Lidcam
from helpers import CLUSTERS, CROSSING
from onnx_files import write_yolox
from small_drive import small_drive

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.results.result import open_result


def recording(path: Path, *, bad: str) -> Path:
    """A lidar, a camera and odometry: a message of `bad` is cut in half."""
    messages = small_drive("ros1", frames=6)
    rows = [row for row, message in enumerate(messages) if message.topic == bad]
    row = rows[len(rows) // 2]
    data = bytes(messages[row].data)
    messages[row] = messages[row]._replace(data=data[: len(data) // 2])
    write_rosbag1(path, messages)
    return path


@pytest.mark.parametrize("bad", ["/cam/image_raw", "/tf_static"])
def test_it_is_counted_or_ends_the_run(lidcam: Lidcam, tmp_path: Path, bad: str) -> None:
    run = lidcam("process", recording(tmp_path / "a.bag", bad=bad), tmp_path / "out.mcap", "--json", "--set", CLUSTERS)
    assert run.code == 3, run.err
    report = json.loads(run.out)
    (drop,) = (drop for drop in report["drops"] if drop["topic"] == bad)
    assert (drop["count"], drop["reason"] != "", report["exit_code"]) == (1, True, 3)
    assert run.err.splitlines()[-1].startswith("lidcam: incomplete: ")
    inspected = lidcam("inspect", tmp_path / "a.bag")
    assert inspected.code == (3 if bad == "/tf_static" else 0)  # it decodes what it needs for the calibration only
    verdict = "cam (/cam/image_raw) is left out" if bad == "/tf_static" else "sound, and all of its sensors can be used"
    assert f"verdict: {verdict}" in inspected.out.splitlines()
    run = lidcam("process", tmp_path / "a.bag", tmp_path / "other.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert bad in run.error_line
    assert not list(tmp_path.glob("other*"))


def clouds() -> list[RawMessage]:
    return small_drive("ros1", frames=3, motion="none", kinds=())


def without(topic: str) -> list[RawMessage]:
    return [one for one in small_drive("ros1", frames=3) if one.topic != topic]


def bag(path: Path, messages: list[RawMessage]) -> Path:
    write_rosbag1(path, messages)
    return path


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


INPUTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no such file": (lambda d: d / "none.bag", "no such"),
    "empty file": (lambda d: written(d / "a.bag", b""), "empty"),
    "no messages": (lambda d: bag(d / "a.bag", []), "no messages"),
    "no lidar": (lambda d: bag(d / "a.bag", without("/points")), "PointCloud2"),
}


@pytest.mark.parametrize(
    ("command", "case"), [*(("process", case) for case in INPUTS), ("inspect", "empty file"), ("inspect", "no lidar")]
)
def test_bad_recording(lidcam: Lidcam, tmp_path: Path, case: str, command: str) -> None:
    make, words = INPUTS[case]
    folder = tmp_path / "in"
    folder.mkdir()
    recording = make(folder)
    outputs = (tmp_path / "out.mcap", "--rerun", tmp_path / "out.rrd") if command == "process" else ()
    run = lidcam(command, recording, *outputs)
    if command == "inspect" and case == "no lidar":  # what is in it is shown all the same
        assert run.out.splitlines()[1].startswith("verdict: lidcam could not process it: ")
    assert run.code == 1
    assert words in run.error_line
    assert run.error_line.count(str(recording)) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def test_names_that_are_no_utf_8(lidcam: Lidcam, tmp_path: Path) -> None:
    """They are read, and shown and recorded with their bytes escaped; onnxruntime alone cannot open one."""
    folder = tmp_path / os.fsdecode(b"dr\xffives")
    folder.mkdir()
    drive, out = bag(folder / os.fsdecode(b"dr\xffive.bag"), clouds()), folder / os.fsdecode(b"o\xfeut.mcap")
    model = write_yolox(tmp_path / "net.onnx", np.zeros((84, 85), np.float32), size_px=(64, 64))
    model = model.rename(folder / os.fsdecode(b"n\xffet.onnx"))
    run = lidcam("process", drive, out, "--rerun", out.with_suffix(".rrd"), "--json-file", folder / "run.json")
    assert (run.code, "Traceback" in run.err) == (0, False), run.err
    with open_result(out) as result:
        assert result.metadata["input.0.name"] == r"dr\udcffive.bag"
    assert lidcam("inspect", drive, "--json").code == lidcam("evaluate", out, "--json").code == 0
    refused = lidcam("process", drive, tmp_path / "out.mcap", "--model-2d", model, "--set", "detect2d.method=onnx")
    assert refused.error_line.endswith(r"n\udcffet.onnx: expected a path in UTF-8, as onnxruntime needs it; rename it")


BLIND = ("--set", "output.images=false")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--set", "sync.slop=1"), 1, "unknown key 'sync.slop': did you mean 'sync.slop_s'?"),
        (("--set", "topics.lidars=/points"), 1, "topics.lidars: expected a list, found '/points'"),
        (("--config", "crosing"), 1, "found neither: did you mean 'crossing'?"),
        (("--model-2d", "none.onnx"), 1, "none.onnx"),
        (("--set", "detect2d.method=onnx"), 1, "--model-2d"),
        (("--start", "1000"), 1, "only"),
        (("--set", "sync.reference=/nothing"), 1, "/nothing"),
        (("--rerun", "/dev/null/out.rrd"), 1, "/dev/null/out.rrd: cannot be written: Not a directory"),
        (("--rerun", "out.txt"), 2, ".rrd"),
        (("--json", "--print-matches"), 2, "--json"),
        (("--duration", "nan"), 2, "--duration"),
        (("--duration", "-1"), 2, "expected more than 0 seconds, found -1"),
        (("--no-such-option",), 2, "--no-such-option"),
        (("process",), 2, "Missing argument"),
        (("process", "a.bag", "b.bag"), 2, "for several recordings: lidcam batch a.bag b.bag --out DIR"),
        (("process", "a.bag", "o.html"), 2, "found o.html (see --rerun, --report, --objects)"),
        (("--topics", "/a"), 2, "--set 'topics.lidars=[/points]' chooses topics"),
        (("--on-bad-message", "x"), 2, "expected one of 'skip', 'fail', found 'x'"),
        (("--workers", "0"), 2, "'--workers': expected at least 1"),
        (("--every", "x"), 2, "'--every': expected a whole number"),
        (("--model-2d", "yolov8n.pt"), 1, "yolo export model=yolov8n.pt format=onnx"),
        (("--foxglove", "http"), 1, "foxglove: expected PORT or HOST:PORT, found 'http'"),
        (("--pace", "0"), 1, "pace: expected more than 0, found 0.0"),
        (("--set", "detect3d.method=callable"), 1, "if detector is given, and only then"),
        (("process", "crossing.mcap", "o.mcap", "--video", "o.mp4", *BLIND), 1, "o.mp4: needs images: set output.ima"),
        (("process", "crossing.mcap", "o.mcap", "--save-matches", "x", *BLIND), 1, "x: needs images: set output.ima"),
        (("batch", "a.bag", "--out", "x", "--set", "sync.slop=1"), 1, "slop"),
        (("batch", "a.bag", "--out", "x", "--rig", "nothing.yaml"), 1, "nothing.yaml"),
        (("batch", "a.bag", "--out", "x", "--jobs", "0"), 2, "--jobs"),
        (("batch", "a.bag", "--out", "x", "--address", "head:6379"), 2, "--engine ray"),
        (("export", "crossing.mcap", "--out", "x"), 2, "Choose from: kitti, kitti-tracking, nuscenes"),
        (("view", "a.bag"), 1, "which ends in .rrd, .html, .mp4 or .mcap; to process a recording: lidcam a.bag"),
        (("process", "."), 2, "holds 2 recordings; process all of them: lidcam batch "),
        (("result.rrd",), 2, "result.rrd is a result of lidcam: `lidcam view result.rrd` opens it"),
        (("drive.bagg",), 1, "drive.bagg: no such file or folder; expected a ROS 1 .bag"),
        (("procss", "a.bag"), 2, "Did you mean 'process'?"),
        (("config", "show", "snadbox"), 1, "a YAML file, found neither: did you mean 'sandbox'?"),
        (("inspect", "a.bag", "-v", "-q"), 2, "expected"),
        (("inspect", "a.bag", "--log-file", "drive.bag"), 2, "expected"),
        (("inspect", "a.bag", "--repair", "out.bag"), 2, ".mcap"),
        (("evaluate", "crossing.mcap"), 1, "expected a result of lidcam, found a recording"),
        (("demo", "a.bag"), 1, "a.bag: cannot write there: File exists; choose another folder"),
        (("drive", "vehicle", "out.bag", "--keys", "w"), 1, "expected a vehicle with `commands: true` to drive"),
        (("drive", "sandbox", "out.bag", "--key-interval", "0"), 2, "key-interval"),
        (("drive", "sandbox", "out.bag", "--keys", "hello"), 1, "expected w s a d x 1 2 o . (. waits), found 'h'"),
        (("simulate", "moon", "out.bag"), 1, "moon: expected one of crossing, sandbox, vehicle, or a .yaml"),
        (("simulate", "sandbox", "o.db3"), 1, "o.db3: expected a name that ends in .bag (ROS 1) or .mcap (ROS 2)"),
        (("simulate", "sandbox", "out.bag", "--set", "lidars.velodyne9.topic=/a"), 1, "lidars.velodyne9"),
        (("simulate", "sandbox", "a.bag/out.bag", "--duration", "0.1"), 1, "a.bag/out.bag: cannot be written"),
        (("simulate", "sandbox", "out.bag", "--duration", "0"), 2, "more than 0 seconds"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_commands(lidcam: Lidcam, tmp_path: Path, arguments: tuple[str, ...], code: int, words: str) -> None:
    """Options alone are those of `lidcam process`."""
    bag(tmp_path / "a.bag", clouds())
    (tmp_path / "crossing.mcap").symlink_to(CROSSING)
    of_process = ("process", "a.bag", "o.mcap") if arguments[0].startswith("-") else ()
    run = lidcam(*of_process, *arguments, folder=tmp_path)
    assert (run.code, "Traceback" in run.err) == (code, False), run.err
    assert words in (run.error_line if code == 1 else " ".join(run.err.split()))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag", "crossing.mcap"]


@pytest.mark.parametrize("command", ["process", "inspect"])
def test_a_sensor_that_the_rig_names_and_the_recording_lacks(lidcam: Lidcam, tmp_path: Path, command: str) -> None:
    recording, rig = bag(tmp_path / "a.bag", clouds()), tmp_path / "rig.yaml"
    eye = np.eye(4).tolist()
    lidars = {name: {"topic": f"/{name}", "T_site_lidar": eye} for name in ("points", "rear")}
    rig.write_text(json.dumps({"site_frame": "site", "lidars": lidars}))
    outputs = [tmp_path / "out.mcap"] if command == "process" else []
    run = lidcam(command, recording, *outputs, "--rig", rig, "--json")
    assert run.code == 3, run.err
    assert run.err.splitlines()[-1] == "lidcam: incomplete: rear (/rear) is left out; exit code 3"
    tree = json.loads(run.out)
    assert (tree["failure"], tree["incomplete"], tree["exit_code"]) == ("", ["rear (/rear) is left out"], 3)
