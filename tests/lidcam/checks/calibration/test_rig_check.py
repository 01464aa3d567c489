"""An error of a camera is named and corrected; good cameras, and those with little evidence, are left alone."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from builders import pointcloud2, raw
from detections import forward_camera
from frames import frame
from helpers import CLUSTERS, ROOT, SANDBOX
from wrong_cameras import CAMERA, cuboids, passing, without_tracks

import lidcam
from lidcam.checks.calibration.rig_check import CalibrationCheck, RigCheck
from lidcam.cli.printing.rig_check import check_tree, print_check
from lidcam.cli.printing.terminal import console
from lidcam.pipeline.calibration.lidar_error import LidarError
from lidcam.pipeline.calibration.lidar_poses import ComparedLidars, LidarPair, moved_lidar
from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraFit, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.summary import camera_corrections

RIG = Rig("site", (), (CAMERA, forward_camera("silent")), ())
CONFIG = Config()
DEGREE = np.pi / 180
PAGE = (ROOT / "docs" / "rig.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True, scope="module")
def _objects_are_cuboids() -> Iterator[None]:
    with patch("lidcam.pipeline.calibration.camera_error.rounded_outline", cuboids):
        yield


def checked(frames: Sequence[FrameResult]) -> RigCheck:
    check = RigCheck(RIG, CONFIG)
    for one in frames:
        check.add_frame(one)
    return check


@pytest.mark.parametrize(
    ("values", "finding"),
    [
        ((0, 0.03, 0, 0, 0, 0, 0), " degrees further left than calibrated"),
        ((0, -0.03, 0, 0, 0, 0, 0), " degrees further right than calibrated"),
        ((0.03, 0, 0, 0, 0, 0, 0), " degrees further down than calibrated"),
        ((0, 0, -0.03, 0, 0, 0, 0), " degrees clockwise"),
        ((0, 0, 0, 0, 0, 0, 0.09), " ms later than their stamps say"),
        ((0, 0, 0, 0, 0, 0, -0.09), " ms earlier than their stamps say"),
    ],
)
def test_an_error_is_named_and_corrected(values: tuple[float, ...], finding: str) -> None:
    check = checked(passing(values, noise=0.3))
    [warning] = check.warnings
    assert warning.subject == "cam"
    assert finding in warning.finding
    assert " and " not in warning.finding
    camera, silent = check.corrected().cameras
    assert silent is RIG.cameras[1]
    turn = camera.T_camera_site.matrix @ np.linalg.inv(CAMERA.T_camera_site.matrix)
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], values[:3], atol=0.004)
    assert camera.time_offset_ns == pytest.approx(-values[6] * 1e9, abs=6e6)


@pytest.mark.parametrize(("yaw", "written"), [(0.03, 0.03), (0.002, 0.0)])
def test_the_errors_are_those_of_the_recorded_pose_where_the_run_turned_a_camera(yaw: float, written: float) -> None:
    done = np.array([0.001, 0.7 * yaw, 0, 0, 0, 0, 0.002])
    pose = replace(CAMERA.T_camera_site, matrix=motion(done) @ CAMERA.T_camera_site.matrix)
    used = replace(CAMERA, T_camera_site=pose, time_offset_ns=-2_000_000, fit=CameraFit(tuple(done.tolist())))
    check = RigCheck(Rig("site", (), (used,), ()), CONFIG)
    for one in passing(np.array([0, yaw, 0, 0, 0, 0, 0.002]) - done, noise=0.3, camera=used):
        check.add_frame(one)
    assert check.correction_count == len(check.warnings) == (written > 0)
    [camera] = check.corrected().cameras
    turn = camera.T_camera_site.matrix @ np.linalg.inv(CAMERA.T_camera_site.matrix)
    assert turn[0, 2] == pytest.approx(written, abs=0.004)
    assert written or (np.abs(turn - np.eye(4)).max() < 1e-9 and camera.time_offset_ns == 0)


@pytest.mark.parametrize(("why", "is_named"), [(Missing.SILENT, True), (Missing.NOT_NEAR, False)])
def test_a_dead_lidar_does_not_keep_cameras_from_being_judged(why: Missing, is_named: bool) -> None:
    dead = LidarSensor("dead", "/dead", Transform("site", "dead", np.eye(4)))
    check = RigCheck(replace(RIG, lidars=(dead,)), CONFIG)
    for one in passing((0, 0.03, 0, 0, 0, 0, 0), noise=0.3):
        check.add_frame(replace(one, bundle=replace(one.bundle, missing={"/dead": why})))
    assert [warning.subject for warning in check.warnings] == ["cam"] * is_named


@pytest.mark.parametrize(
    ("frames", "x_m", "is_named"),
    [
        ("velodyne velodyne", 0, True),
        ("velodyne velodyne", 1, False),
        ("a b", 0, False),
        ("base_link base_link", 0, False),
    ],
)
def test_lidars_in_one_frame_whose_clouds_show_nothing_in_common(frames: str, x_m: float, is_named: bool) -> None:
    at = [motion(np.array([0, 0, 0, x, 0, 0])) for x in (0.0, x_m)]
    poses = [Transform("site", frame, pose) for frame, pose in zip(frames.split(), at, strict=True)]
    one, other = (LidarSensor(name, f"/{name}", pose) for name, pose in zip(("left", "right"), poses, strict=True))
    compared = ComparedLidars((LidarPair(one, other, None),), ())
    warnings = RigCheck(Rig("site", (one, other), (), ()), CONFIG, compared).warnings
    assert [warning.subject for warning in warnings] == ["right"] * is_named


@pytest.mark.parametrize("is_first_off", [False, True])
def test_of_two_lidars_the_one_that_is_off_is_named(*, is_first_off: bool) -> None:
    left, right = (LidarSensor(name, f"/{name}", Transform("site", name, np.eye(4))) for name in ("left", "right"))
    pair = LidarPair(left, right, LidarError(0.2 * np.eye(6)[3], 1e-6 * np.eye(6), 500), is_first_off)
    [warning] = RigCheck(Rig("site", (left, right), (), ()), CONFIG, ComparedLidars((pair,), ())).warnings
    assert warning.subject == ("left" if is_first_off else "right")
    assert warning.finding == "what right sees lies beside what left sees, by 0.20 ± 0.00 m along x"


@pytest.mark.parametrize("moved", [(), (1,), (0, 2)])
def test_lidars_that_stay_are_no_corrections(moved: tuple[int, ...]) -> None:
    lidars = [LidarSensor(f"lidar{row}", f"/{row}", Transform("site", f"lidar{row}", np.eye(4))) for row in range(3)]
    motions = [np.full(6, 0.1 if row in moved else 1e-9) for row in range(3)]
    agreeing = tuple(map(moved_lidar, lidars, motions)) if moved else ()
    check = RigCheck(Rig("site", tuple(lidars), (), ()), CONFIG, ComparedLidars((), agreeing))
    assert check.correction_count == len(moved)


@pytest.mark.parametrize("late_s", [0.0, 0.09])
def test_a_lens_that_a_run_changed_is_named_and_a_clock_that_may_look_like_it(late_s: float) -> None:
    changed = replace(CAMERA, model=CAMERA.model.zoomed(1.2), fit=CameraFit(zoom=1.2))
    check = RigCheck(replace(RIG, cameras=(changed,)), CONFIG)
    for one in passing((0, 0, 0, 0, 0, 0, late_s), noise=0.3, camera=changed):
        check.add_frame(one)
    [warning] = check.warnings
    focal_px = CAMERA.model.K[0, 0]
    assert f"fit a focal length of {1.2 * focal_px:.0f} px, not {focal_px:.0f} px" in warning.finding
    assert (" ms later than their stamps say" in warning.finding) == (late_s > 0)
    assert ("check its clock first" in warning.remedy) == (late_s > 0)
    assert camera_corrections(replace(RIG, cameras=(changed,)))["cam"].zoom == 1.2


def test_several_errors_are_in_one_sentence_as_documented() -> None:
    [warning] = checked(passing((0, 0.03, 0, 0, 0, 0, 0.09), noise=0.3)).warnings
    words = re.sub(r"\d+(?:\.\d+)?", "0", warning.finding).replace("by 0 boxes of 0", "by N boxes of M")
    assert words in re.sub(r"\d+(?:\.\d+)?", "0", PAGE)


@pytest.mark.parametrize(
    "frames",
    [passing(), passing(speed_m_s=8.0), passing((0, 0.003, 0, 0, 0, 0, 0.005)), without_tracks(passing()), []],
    ids=["good", "good, driving", "too small to matter", "no tracks", "nothing"],
)
def test_good_rigs_give_no_warning(frames: list[FrameResult]) -> None:
    check = checked(frames)
    assert check.warnings == ()
    assert check.corrected().cameras == RIG.cameras


def test_a_place_that_no_half_of_a_run_can_tell_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = passing((0, 0, 0, 0, 0.5, 0, 0), noise=0.1)
    camera = checked(frames).cameras[0]
    assert camera.significant[3:6].any()
    monkeypatch.setattr("lidcam.pipeline.calibration.camera_error.MIN_PAIRS", int(0.7 * camera.pair_count))
    assert not checked(frames).cameras[0].significant[3:6].any()


def test_verdicts_are_printed_and_written_as_values(capsys: pytest.CaptureFixture[str]) -> None:
    check = checked(passing((0, 0.03, 0, 0, 0, 0, 0), noise=0.3))
    print_check(console(), check)
    printed = capsys.readouterr().out
    assert "not judged" in printed
    assert "warning: cam: judging by " in printed
    tree = check_tree(check)
    yaw = tree["cameras"]["cam"]["errors"]["yaw_deg"]
    assert yaw["is_significant"]
    assert yaw["value"] == pytest.approx(0.03 / DEGREE, abs=0.2)
    assert tree["cameras"]["silent"] == {"pairs": 0, "tracks": 0, "errors": None}
    assert tree["lidars"] == []


def test_the_sample_as_calibrated_gives_no_warning() -> None:
    assert lidcam.process(SANDBOX, config="sandbox", settings=[CLUSTERS]).summary.warnings == ()
    assert lidcam.inspect(SANDBOX).warnings == ()


def test_an_inverted_lidar_is_named_and_not_the_cameras(tmp_path: Path) -> None:
    tree = yaml.safe_load(SANDBOX.with_name("sandbox.bag.rig.yaml").read_text())
    del tree["ground_height_m"]
    lidar = tree["lidars"]["velodyne3"]
    lidar["T_site_lidar"] = np.linalg.inv(lidar["T_site_lidar"]).tolist()
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(tree))
    report = lidcam.process(SANDBOX, config="sandbox", settings=[CLUSTERS], rig=rig).summary
    by_subject = {warning.subject: str(warning) for warning in report.warnings}
    assert by_subject.keys() == {"ground", "velodyne3"}
    assert by_subject["velodyne3"].startswith(
        "velodyne3: its ground lies at z = -0.87 m, and with the inverse of its extrinsics at 0.00 m"
    )
    # On one sweep: the defaults are for metres, not for a model of 1:14.
    of_model = {"combine.ground.height_tolerance_m": 0.1, "combine.ground.distance_m": 0.02}
    [warning] = lidcam.inspect(SANDBOX, rig=rig, settings=of_model).warnings
    assert warning.subject == "velodyne3"


def ground_message(sensor: LidarSensor, *, stamp_ns: int) -> RawMessage:
    """Flat ground around a lidar, in the lidar's frame."""
    random = np.random.default_rng(1)
    xyz = np.c_[random.uniform(-15, 15, (1500, 2)), np.full(1500, -sensor.T_site_lidar.translation[2])]
    fields = pointcloud2(xyz.astype(np.float32), stamp_ns=stamp_ns, frame_id=sensor.name)
    return raw(sensor.topic, "sensor_msgs/msg/PointCloud2", fields, stamp_ns)


def test_a_lidar_that_begins_late_is_looked_at_too() -> None:
    """It is in the last two of five frames. Cameras are told only where they are not used."""
    places = {"a": (0.0, 0.0, 1.8), "b": (0.0, 3.0, 2.4), "late": (0.0, -3.0, 1.2)}
    *others, late = (
        LidarSensor(name, f"/{name}", Transform.from_quaternion("site", name, place, (0, 0, 0, 1)))
        for name, place in places.items()
    )
    inverted = replace(late, T_site_lidar=Transform("site", late.name, late.T_site_lidar.inverse().matrix))
    unused = replace(forward_camera("unused"), fit=CameraFit(is_used=False))
    check = CalibrationCheck(Rig("site", (*others, inverted), (forward_camera("sound"), unused), ()), Config())
    for index in range(5):
        lidars = [*others, late] if index >= 3 else others
        messages = {lidar.topic: ground_message(lidar, stamp_ns=10**9 + index) for lidar in lidars}
        whole = frame(index)
        check.add_frame(replace(whole, bundle=replace(whole.bundle, messages=messages)))
    assert [warning.subject for warning in check.warnings] == ["late", "unused"]
