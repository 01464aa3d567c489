"""Which truth is taken: labels, odometry that the rig calls truth, topics."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import odometry, raw, write_mcap
from frames import CONFIG, PERIOD_NS, RIG, START_NS, frame, written_result
from helpers import CROSSING, SANDBOX

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig, TruthVehicle
from lidcam.readers.results.attached_records import read_records
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.truth.kitti import KittiTruth
from lidcam.readers.truth.odometry import OdometryTruth
from lidcam.readers.truth.open import open_labels, open_truth
from lidcam.readers.truth.source import TruthSource

CAR = TruthVehicle("/car/odom", "car", (4, 2, 1.5), (0, 0, 0.75))
LABEL = "Car 0.10 1 -1.57 500.0 150.0 600.0 220.0 1.50 1.80 4.20 2.0 1.6 20.0 -1.570796"


def pose(k: int) -> RawMessage:
    stamp_ns = START_NS + k * PERIOD_NS
    fields = odometry(stamp_ns=stamp_ns, position=(k, 2, 0), frame_id=RIG.site_frame, child_frame_id="car")
    return raw(CAR.topic, "nav_msgs/msg/Odometry", fields, stamp_ns)


def result(folder: Path, rig: Rig, copied: tuple[RawMessage, ...] = ()) -> Result:
    one = frame(0)
    frames = [replace(one, bundle=replace(one.bundle, copied=copied))]
    return open_result(written_result(folder / "out.mcap", frames, rig=rig))


def test_odometry_that_was_copied_into_the_result(tmp_path: Path) -> None:
    rig = replace(RIG, truth={"car": CAR})
    with result(tmp_path, rig, (pose(0), pose(1))) as opened, open_truth(opened) as truth:
        assert isinstance(truth.source, OdometryTruth)
        found = truth.source.at(START_NS + PERIOD_NS // 2, frame=0)
    assert found is not None
    np.testing.assert_allclose(found.centers, [[0.5, 2, 0.75]])


def test_odometry_of_another_recording(tmp_path: Path) -> None:
    write_mcap(tmp_path / "drive.mcap", [pose(0), pose(1)])
    with (
        result(tmp_path, replace(RIG, truth={"car": CAR})) as opened,
        open_truth(opened, [tmp_path / "drive.mcap"]) as truth,
    ):
        assert isinstance(truth.source, OdometryTruth)
        assert truth.source.at(START_NS, frame=0) is not None


def test_without_the_odometry_topics_count(tmp_path: Path) -> None:
    with result(tmp_path, replace(RIG, truth={"car": CAR})) as opened, open_truth(opened) as truth:
        assert truth.source is None
        assert "expected truth" in truth.reason


def test_odometry_of_some_vehicles_only(tmp_path: Path) -> None:
    rig = replace(RIG, truth={"car": CAR, "van": replace(CAR, topic="/van/odom")})
    with result(tmp_path, rig, (pose(0),)) as one, pytest.raises(RecordingError, match=r"truth\.van"), open_truth(one):
        pass


# --- label files, by their content

ONE_LIDAR = replace(RIG, lidars=RIG.lidars[:1])


def opened(path: Path) -> TruthSource | None:
    return open_labels(path, ONE_LIDAR, CONFIG)


@pytest.mark.parametrize(
    ("file", "given"), [("a.txt", "a.txt"), ("label_2/000001.txt", ""), ("label_2/000001.txt", "label_2")]
)
def test_the_content_says_what_it_is(tmp_path: Path, file: str, given: str) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(LABEL)
    assert isinstance(opened(tmp_path / given), KittiTruth)


def test_recordings_are_for_others_to_open(tmp_path: Path) -> None:
    (tmp_path / "drive.db3").write_text("")
    for path in (SANDBOX, CROSSING, tmp_path):
        assert opened(path) is None


@pytest.mark.parametrize(
    ("files", "given", "problem"),
    [
        ({}, "none", "none: no such file or folder; expected truth: a recording, a result, or KITTI's labels"),
        ({"a.txt": "hello"}, "a.txt", "found a file of another kind"),
        ({"a.txt": ""}, "a.txt", "found a file of another kind"),
        ({}, "", "found an empty folder"),
        ({"a.png": "", "b.png": ""}, "", "found a folder with a.png, b.png"),
    ],
)
def test_what_is_no_truth(tmp_path: Path, files: dict[str, str], given: str, problem: str) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError) as caught:
        opened(tmp_path / given)
    assert problem in str(caught.value)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match=r"pipe: expected truth: .*found a FIFO or a device"):
        opened(tmp_path / "pipe")
    with pytest.raises(RecordingError, match=r"pipe: expected a result of lidcam.*found a FIFO or a device"):
        read_records(tmp_path / "pipe")
