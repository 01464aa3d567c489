"""The verdict of an inspection: what it says, in which words, and what a rig or a repair that is asked for changes."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from builders import odometry, pointcloud2, raw, write_rosbag1
from logging_state import kept_logging

from lidcam.cli.inspect import inspect
from lidcam.pipeline.core.errors import CheckError, IncompleteError
from lidcam.readers.open import open_recording
from lidcam.readers.rig.rig_file import load_rig

STEP_NS = 100_000_000
NOWHERE = "rig.site_frame=nowhere"


def recording(path: Path, *lidars: str) -> Path:
    messages = []
    for number in range(3):
        stamp_ns = 10**18 + number * STEP_NS
        points = np.random.default_rng(number).uniform([3, -5, -1], [9, 5, 1], (200, 3))
        for lidar in lidars:
            cloud = pointcloud2(points, stamp_ns=stamp_ns, frame_id=lidar)
            messages.append(raw(f"/{lidar}", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, encoding="ros1"))
        messages.append(raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=stamp_ns), stamp_ns, encoding="ros1"))
    write_rosbag1(path, messages)
    return path


def inspected(path: Path, *settings: str, **options: Any) -> None:
    with kept_logging():
        inspect([str(path)], settings=settings, as_json=True, **options)


def printed(capsys: pytest.CaptureFixture[str]) -> tuple[str, list[str], int]:
    tree = json.loads(capsys.readouterr().out)
    return tree["failure"], tree["incomplete"], tree["exit_code"]


def test_a_rig_to_start_from_is_no_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, rig = recording(tmp_path / "a.bag", "top"), tmp_path / "rig.yaml"
    with pytest.raises(IncompleteError, match="lidcam could not process it: "):
        inspected(path, NOWHERE, write_rig=rig)
    failure, (incomplete,), code = printed(capsys)
    assert (failure, code) == ("", 3)
    assert incomplete.startswith("lidcam could not process it: ")
    assert "TODO" in rig.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("detect2d.model=none.onnx",), "none.onnx: expected an ONNX file, found no such file"),
        (("detect3d.model=none.onnx",), "none.onnx: expected an ONNX file, or a network that comes with"),
        (("detect2d.method=recorded",), "expected recorded 2D boxes"),
    ],
)
def test_networks_that_a_run_could_not_use_are_its_problem(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], settings: tuple[str, ...], words: str
) -> None:
    with pytest.raises(CheckError, match=f"lidcam could not process it: .*{words}"):
        inspected(recording(tmp_path / "a.bag", "top"), *settings)
    assert printed(capsys)[2] == 1


def test_a_check_sees_messages_that_cannot_be_decoded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = recording(tmp_path / "good.bag", "top"), tmp_path / "bad.bag"
    with open_recording([good]) as opened:
        messages = [one if one.log_time_ns % 10**9 == 0 else one._replace(data=b"") for one in opened.messages()]
    write_rosbag1(bad, messages)
    inspected(bad)
    assert printed(capsys) == ("", [], 0)
    with pytest.raises(IncompleteError, match="/top: 2 messages dropped: cannot be decoded"):
        inspected(bad, check=True)
    assert printed(capsys)[2] == 3


def test_without_sensors_there_is_no_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, rig = recording(tmp_path / "a.bag"), tmp_path / "rig.yaml"
    with pytest.raises(CheckError, match="no rig to write: "):
        inspected(path, write_rig=rig)
    assert printed(capsys)[2] == 1
    assert not rig.exists()


@pytest.mark.parametrize(
    ("requirement", "failure"),
    [
        ("topics./top.rate_hz >= 9.5", ""),
        ("sensors.top.usable == 1", ""),
        ("topics./odom.count == 4", "topics./odom.count: expected == 4, found 3"),
        ("skew_max_ms < 0", "skew_max_ms: expected < 0, found 0.0"),
        (
            "topics./left.rate_hz >= 9",
            "topics./left.rate_hz: expected >= 9, found no such figure: did you "
            "mean 'topics./top.rate_hz', 'topics./odom.rate_hz' or 'topics./top.delay_s'?",
        ),
    ],
)
def test_requirements_on_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], requirement: str, failure: str
) -> None:
    path = recording(tmp_path / "a.bag", "top")
    with pytest.raises(CheckError) if failure else nullcontext():
        inspected(path, requirements=[requirement])
    tree = json.loads(capsys.readouterr().out)
    assert (tree["failure"], tree["exit_code"]) == (failure, 1 if failure else 0)
    assert [one["is_met"] for one in tree["requirements"]] == [not failure]


def test_a_malformed_requirement_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match="expected a figure, a comparison and a number"):
        inspected(tmp_path / "no.bag", requirements=["fast"])


def test_requirements_of_what_cannot_be_processed_are_checked_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recording(tmp_path / "a.bag", "top")
    with pytest.raises(CheckError):
        inspected(path, NOWHERE, requirements=["lidars >= 1"])
    failure, _, code = printed(capsys)
    assert failure.startswith(f"{path}: lidcam could not process it: ")
    assert failure.endswith("; lidars: expected >= 1, found 0")
    assert code == 1


def test_a_repair_judges_the_copy_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inspected(recording(tmp_path / "a.bag"), repair=tmp_path / "whole.mcap")
    assert printed(capsys) == ("", [], 0)
    assert (tmp_path / "whole.mcap").exists()


def test_a_check_processes_the_recording_and_writes_the_rig_that_it_would_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, rig = recording(tmp_path / "a.bag", "top", "low"), tmp_path / "rig.yaml"
    inspected(path, check=True, write_rig=rig, rig=[str(two_lidars(tmp_path))])
    tree = json.loads(capsys.readouterr().out)
    assert tree["check"] == {
        "cameras": {},
        "lidars": [{"lidar": "low", "against": "top", "points": 0, "errors": None}],
        "warnings": [],
    }
    assert [*(load_rig(rig).lidars or {})] == ["top", "low"]


def two_lidars(folder: Path) -> Path:
    path = folder / "given.yaml"
    lidars = (f"  {name}: {{topic: /{name}, translation_m: [0, 0, {z}]}}\n" for name, z in (("top", 0), ("low", 1)))
    path.write_text(f"site_frame: site\nlidars:\n{''.join(lidars)}")
    return path
