"""Wrong input: one clear line, the right exit code, and no output left behind."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from builders import camera_info, image, pointcloud2, raw, write_rosbag1
from command import Lidcam
from onnx_files import write_yolox

from pipeline.core.messages import RawMessage

STEP_NS = 100_000_000


def clouds(count: int, *, bad: tuple[int, ...] = ()) -> list[RawMessage]:
    points = np.random.default_rng(0).uniform([5, -5, -1], [15, 5, 1], (200, 3)).astype(np.float32)
    messages = []
    for i in range(count):
        cloud = pointcloud2(points, stamp_ns=i * STEP_NS + 1, frame_id="lidar")
        if i in bad:
            cloud = {**cloud, "width": 10_000}
        messages.append(raw("/points", "sensor_msgs/msg/PointCloud2", cloud, i * STEP_NS + 1, encoding="ros1"))
    return messages


def images(count: int) -> list[RawMessage]:
    rgb = np.zeros((48, 64, 3), np.uint8)
    return [
        raw(
            "/cam/image_raw",
            "sensor_msgs/msg/Image",
            image(rgb, stamp_ns=i * STEP_NS + 1, frame_id="cam"),
            i * STEP_NS + 1,
            encoding="ros1",
        )
        for i in range(count)
    ]


def bag(path: Path, messages: list[RawMessage]) -> Path:
    write_rosbag1(path, messages)
    return path


INPUTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no such file": (lambda d: d / "none.bag", r"no such"),
    "folder without a bag": (lambda d: d, r""),
    "text file": (lambda d: _write(d / "a.bag", b"hello, this is text\n"), r""),
    "empty file": (lambda d: _write(d / "a.bag", b""), r"empty"),
    "no messages": (lambda d: bag(d / "a.bag", []), r"no messages"),
    "no lidar": (lambda d: bag(d / "a.bag", images(3)), r"PointCloud2"),
}


def _write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("command", ["process", "inspect"])
@pytest.mark.parametrize("case", INPUTS)
def test_bad_recording(lidcam: Lidcam, tmp_path: Path, case: str, command: str) -> None:
    make, words = INPUTS[case]
    folder = tmp_path / "in"
    folder.mkdir()
    recording, out = make(folder), tmp_path / "out.mcap"
    if command == "inspect":
        run = lidcam("inspect", recording)
        if case == "no lidar":  # what is in it is shown all the same
            assert words in run.out
            assert run.out.splitlines()[-1] == "verdict: lidcam could not process it"
    else:
        run = lidcam("process", recording, out, "--rerun", tmp_path / "out.rrd")
    assert run.code == 1
    assert words in run.error_line
    assert str(recording) in run.error_line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def test_no_camera_is_lidar_only(lidcam: Lidcam, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    run = lidcam("process", bag(tmp_path / "a.bag", clouds(3)), out)
    assert run.code == 0, run.err
    assert "lidar-only" in run.out
    assert out.exists()


@pytest.mark.parametrize(("method", "words"), [("onnx", "expected images"), ("recorded", "expected recorded 2D boxes")])
def test_2d_detection_without_a_camera_is_an_error(lidcam: Lidcam, tmp_path: Path, method: str, words: str) -> None:
    model = write_yolox(tmp_path / "model.onnx", np.zeros((21, 85), np.float32), size_px=(32, 32))
    out = tmp_path / "out.mcap"
    recording = bag(tmp_path / "a.bag", clouds(3))
    run = lidcam("process", recording, out, "--model-2d", model, "--set", f"detect2d.method={method}")
    assert run.code == 1
    assert words in run.error_line
    assert str(recording) in run.error_line
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--set", "sync.polcy=nearest"), 1, "unknown key 'sync.polcy'"),
        (("--config", "none.yaml"), 1, "none.yaml"),
        (("--rig", "none.yaml"), 1, "none.yaml"),
        (("--model-2d", "none.onnx"), 1, "none.onnx"),
        (("--set", "detect2d.method=onnx"), 1, "--model-2d"),
        (("--start", "1000"), 1, "only"),
        (("--set", "sync.reference=/nothing"), 1, "/nothing"),
        (("--set", "topics.lidars=[/nothing]"), 1, "/nothing"),
        (("--rerun", "no_folder/out.rrd"), 1, "no_folder"),
        (("--rerun", "out.txt"), 2, ".rrd"),
        (("--workers", "0"), 2, "--workers"),
        (("--start", "-1"), 2, "--start"),
        (("--no-such-option",), 2, "--no-such-option"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_options(lidcam: Lidcam, tmp_path: Path, arguments: tuple[str, ...], code: int, words: str) -> None:
    recording = bag(tmp_path / "a.bag", clouds(3))
    run = lidcam("process", recording, tmp_path / "out.mcap", *arguments)
    assert (run.code, "Traceback" in run.err) == (code, False), run.err
    assert words in (run.error_line if code == 1 else run.err)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag"]


@pytest.mark.parametrize("output", ["a.bag", "out.txt"])
def test_output_that_is_no_mcap_is_wrong_usage(lidcam: Lidcam, tmp_path: Path, output: str) -> None:
    recording = bag(tmp_path / "a.bag", clouds(3))
    before = recording.read_bytes()
    assert lidcam("process", recording, tmp_path / output).code == 2
    assert recording.read_bytes() == before


def test_output_is_the_input(lidcam: Lidcam, tmp_path: Path) -> None:
    recording = tmp_path / "a.mcap"
    recording.write_bytes(b"\x89MCAP0\r\n")
    run = lidcam("process", recording, recording)
    assert run.code == 1
    assert "is an input of this run" in run.error_line


def test_wrong_usage_without_arguments(lidcam: Lidcam) -> None:
    assert lidcam("process").code == 2
    assert lidcam("process", "only_one.bag").code == 2


def test_bad_message_is_skipped_counted_and_shown(lidcam: Lidcam, tmp_path: Path) -> None:
    recording, out = bag(tmp_path / "a.bag", clouds(5, bad=(2,))), tmp_path / "out.mcap"
    run = lidcam("process", recording, out)
    assert run.code == 3, run.err
    assert "cannot be decoded" in run.out
    assert out.exists()


def test_bad_message_ends_the_run_on_demand(lidcam: Lidcam, tmp_path: Path) -> None:
    recording, out = bag(tmp_path / "a.bag", clouds(5, bad=(2,))), tmp_path / "out.mcap"
    run = lidcam("process", recording, out, "--on-bad-message", "fail")
    assert run.code == 1
    assert "/points" in run.error_line
    assert "frame 2" in run.err
    assert not list(tmp_path.glob("out*"))


def test_faults_of_all_cameras_leave_the_lidars_and_the_table_says_so(lidcam: Lidcam, tmp_path: Path) -> None:
    messages = sorted([*clouds(4), *images(4)], key=lambda m: m.log_time_ns)  # no CameraInfo
    model = write_yolox(tmp_path / "model.onnx", np.zeros((21, 85), np.float32), size_px=(32, 32))
    run = lidcam("process", bag(tmp_path / "a.bag", messages), tmp_path / "out.mcap", "--model-2d", model)
    assert run.code == 3, run.err
    assert "left out: cam" in run.out
    assert "2D boxes   none: lidar-only" in run.out


@pytest.mark.parametrize("command", ["process", "inspect"])
def test_a_sensor_that_the_rig_names_and_the_recording_lacks(lidcam: Lidcam, tmp_path: Path, command: str) -> None:
    recording, rig = bag(tmp_path / "a.bag", clouds(3)), tmp_path / "rig.yaml"
    eye = np.eye(4).tolist()
    lidars = {name: {"topic": f"/{name}", "T_site_lidar": eye} for name in ("points", "rear")}
    rig.write_text(json.dumps({"site_frame": "site", "lidars": lidars}))
    outputs = [tmp_path / "out.mcap"] if command == "process" else []
    run = lidcam(command, recording, *outputs, "--rig", rig, "--json")
    assert run.code == 3, run.err
    assert run.err.splitlines()[-1] == "lidcam: incomplete: rear (/rear) is left out; exit code 3"
    tree = json.loads(run.out)
    assert (tree["failure"], tree["incomplete"], tree["exit_code"]) == ("", ["rear (/rear) is left out"], 3)


def test_fault_of_one_camera_is_named_and_the_run_goes_on(lidcam: Lidcam, tmp_path: Path) -> None:
    info = camera_info(np.zeros((3, 3)), stamp_ns=1, width_px=64, height_px=48, frame_id="cam")
    broken = raw("/cam/camera_info", "sensor_msgs/msg/CameraInfo", info, 1, encoding="ros1")
    messages = sorted([*clouds(4), *images(4), broken], key=lambda m: m.log_time_ns)
    run = lidcam("process", bag(tmp_path / "a.bag", messages), tmp_path / "out.mcap")
    assert run.code == 3, run.err
    assert "cam" in run.err
    assert "left out" in run.out
