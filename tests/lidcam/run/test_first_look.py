"""Cameras are corrected by frames spread over the recording; what they do not show is left alone."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from unittest.mock import Mock, patch

import numpy as np
import pytest
from helpers import CROSSING
from wrong_cameras import CAMERA, cuboids, passing, without_tracks

import lidcam
from lidcam.checks.calibration.rig_check import RigCheck
from lidcam.pipeline.calibration.lidar_poses import moved_lidar
from lidcam.pipeline.calibration.overlap import turned_pose
from lidcam.pipeline.core.frame import Decoded, FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraFit, CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.stages.detect3d import Detect3D
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.open import open_recording
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.run.box_sources import KnownBoxes
from lidcam.run.choice import UsedSettings
from lidcam.run.first_look import (
    BY_P,
    STRETCH_FRAMES,
    corrected_by_recording,
    later_stretches,
    with_agreeing_lidars,
    with_corrections,
)
from lidcam.run.frames import RunInput
from lidcam.run.summary import camera_corrections

RIG = Rig("site", (LidarSensor("lidar", "/points", Transform("site", "lidar", np.eye(4))),), (CAMERA,), ())
DEGREE = np.pi / 180
SETTINGS = {"output.images": False, "run.workers": 1, "detect3d.method": "cluster"}


@pytest.fixture(scope="module")
def crossing() -> Iterator[RunInput]:
    with open_recording([CROSSING]) as recording:
        yield RunInput(recording, RIG, Config.model_validate({"detect2d": {"method": "recorded"}}))


def corrected(source: RunInput, frames: list[FrameResult] | Callable[..., list[FrameResult]]) -> Rig:
    with (
        patch("lidcam.pipeline.calibration.camera_error.rounded_outline", cuboids),
        patch("lidcam.run.first_look.box_source", return_value="recorded"),
        patch("lidcam.run.first_look._looked_at", side_effect=frames if callable(frames) else lambda *_: frames),
    ):
        return corrected_by_recording(source, KnownBoxes(), 1).rig


@pytest.mark.parametrize(
    ("values", "turned_deg", "late_ms"),
    [
        ((0, 0.012, 0, 0, 0, 0, 0), 0.65, 0),
        ((-0.02, 0, 0, 0, 0, 0, 0.04), 1.15, 40),
        ((0, -0.0873, 0, 0, 0, 0, 0), 5.0, 0),
        ((0,) * 7, 0.0, 0),
    ],
    ids=["turned by a little", "turned, and late", "turned by much", "sound"],
)
def test_direction_and_clock_are_corrected(
    crossing: RunInput, values: tuple[float, ...], turned_deg: float, late_ms: float
) -> None:
    def looked_at(source: RunInput, *_: object) -> list[FrameResult]:
        [camera] = source.rig.cameras
        return passing(np.subtract(values, camera.fit.corrected), noise=0.5, camera=camera)

    rig = corrected(crossing, looked_at)
    [camera] = rig.cameras
    turn = camera.T_camera_site.matrix @ np.linalg.inv(CAMERA.T_camera_site.matrix)
    np.testing.assert_allclose([turn[2, 1], turn[0, 2]], values[:2], atol=0.07 * DEGREE)
    assert camera.time_offset_ns == pytest.approx(-1e6 * late_ms, abs=8e6)
    told = camera_corrections(rig)
    assert ("cam" in told) == any(values)
    if told:
        assert told["cam"].turned_deg == pytest.approx(turned_deg, abs=0.1)
        assert told["cam"].late_ms == pytest.approx(late_ms, abs=8)
    assert camera.fit.direction_sigma_rad < 0.2 * DEGREE


@pytest.mark.parametrize(
    ("turn_rad", "late_s", "is_told"), [(1e-5, 0, False), (0, 2e-4, False), (0, 8e-4, True), (3e-4, 0, True)]
)
def test_a_correction_that_the_figures_do_not_show_is_not_told(turn_rad: float, late_s: float, is_told: bool) -> None:
    fit = CameraFit(corrected=(0, turn_rad, 0, 0, 0, 0, late_s))
    assert len(camera_corrections(replace(RIG, cameras=(replace(CAMERA, fit=fit),)))) == is_told


@pytest.mark.parametrize("shown", ["raw", "rectified"])
@pytest.mark.parametrize("off", [0.0, 0.03], ids=["sound pose", "pose off by 1.7 degrees"])
def test_boxes_show_whether_images_are_rectified(crossing: RunInput, shown: str, off: float) -> None:
    wide = replace(CAMERA.model, K=CAMERA.model.K * [[0.8], [0.8], [1]])
    rectified = replace(CAMERA, model=wide)
    camera = replace(CAMERA, rectified=rectified)
    rig = replace(RIG, cameras=(camera,))
    frames = passing((0, off, 0, 0, 0, 0, 0), camera=rectified if shown == "rectified" else CAMERA)
    used = corrected(replace(crossing, rig=rig), frames)
    assert used.cameras[0].model is (wide if shown == "rectified" else CAMERA.model)
    source = SensorSource("cam", "/cam", "cam", "/info", "tf")
    found = with_corrections(Discovery(rig, (), (source,), (), RecordedTransforms(TransformTree())), used)
    assert [source.intrinsics for source in found.sources] == [BY_P if shown == "rectified" else "/info"]
    assert len(found.notes) == (shown == "rectified")


@pytest.mark.parametrize("frames", [[], passing(frames=1), without_tracks(passing())], ids=["none", "one", "untracked"])
def test_a_camera_that_shows_too_little_stays_as_recorded(crossing: RunInput, frames: list[FrameResult]) -> None:
    [camera] = corrected(crossing, frames).cameras
    assert camera is CAMERA


def sure(result: FrameResult) -> FrameResult:
    boxes = result.detections.lidar
    lidar = replace(boxes, scores=np.full(len(boxes), 0.9, np.float32))
    return replace(result, detections=replace(result.detections, lidar=lidar))


@pytest.mark.parametrize(("pitch_deg", "is_used"), [(15, False), (0, True)])
def test_a_camera_that_fits_nowhere_stays_as_recorded_and_is_not_used(
    crossing: RunInput, pitch_deg: int, *, is_used: bool
) -> None:
    camera = replace(CAMERA, T_camera_site=replace(CAMERA.T_camera_site, matrix=turned_pose(CAMERA, 0, pitch_deg)))
    frames = [sure(replace(one, views={"cam": camera})) for one in passing()]
    [used] = corrected(replace(crossing, rig=replace(RIG, cameras=(camera,))), frames).cameras
    assert used.fit.is_used == is_used
    assert (used.T_camera_site is camera.T_camera_site) == (not is_used)


def test_cameras_that_are_not_used_neither_vote_nor_propose() -> None:
    def unused(camera: CameraSensor, *_: object) -> CameraSensor:
        return replace(camera, fit=replace(camera.fit, is_used=False)) if camera.fit.is_used else camera

    with patch("lidcam.run.first_look.used_if_it_fits", side_effect=unused):
        summary = lidcam.process(CROSSING, settings=SETTINGS, duration_s=0.7).summary
    found = summary.frames
    assert (found.confirmed, found.sources["camera"], found.sources["both"]) == (0, 0, 0)
    assert found.sources["lidar"] > 0
    told = {one.subject for one in summary.warnings if "this run does not use its boxes" in one.remedy}
    assert told == {camera.name for camera in summary.sensors.rig.cameras}


@pytest.mark.parametrize("setting", [{"fuse.calibration": "recorded"}, {"detect2d.method": "none"}])
def test_nothing_is_looked_at_without_need(crossing: RunInput, setting: dict[str, str]) -> None:
    config = lidcam.make_job(CROSSING, settings=setting).config
    with patch("lidcam.run.first_look._looked_at", side_effect=AssertionError):
        assert corrected_by_recording(replace(crossing, config=config), KnownBoxes(), 1).rig is RIG


def with_second_lidar(source: RunInput, offset_m: float) -> RunInput:
    """The sample with its own lidars, the second of which is recorded beside its place."""
    rig = discover_rig(source.recording, Config()).rig
    first, second = rig.lidars
    wrong = moved_lidar(second, np.array([0, 0, 0, 0, 0, offset_m]))
    return replace(source, rig=replace(rig, lidars=(first, wrong)))


@pytest.mark.parametrize(("offset_m", "moved_m"), [(0.5, (0.0, -0.5)), (0.05, (0.025, -0.025)), (0.0, (0.0, 0.0))])
def test_lidars_are_moved_until_they_agree(crossing: RunInput, offset_m: float, moved_m: tuple[float, float]) -> None:
    source = with_second_lidar(crossing, offset_m)
    used = with_agreeing_lidars(source)
    moves = [
        found.T_site_lidar.translation[2] - lidar.T_site_lidar.translation[2]
        for found, lidar in zip(used.rig.lidars, source.rig.lidars, strict=True)
    ]
    np.testing.assert_allclose(moves, moved_m, atol=0.02 + 0.05 * offset_m)
    assert (used.rig.lidars is source.rig.lidars) == (offset_m == 0)
    notes = with_corrections(Discovery(source.rig, (), (), (), RecordedTransforms(TransformTree())), used.rig).notes
    assert len(notes) == (offset_m != 0)
    check = RigCheck(used.rig, used.config, used.compared)
    assert len(check.warnings) == (offset_m != 0)
    assert check.corrected().lidars == used.rig.lidars


def test_lidars_stay_as_recorded_if_the_settings_say_so(crossing: RunInput) -> None:
    config = lidcam.make_job(CROSSING, settings={"fuse.calibration": "recorded"}).config
    source = replace(with_second_lidar(crossing, 0.5), config=config)
    used = with_agreeing_lidars(source)
    assert used.rig.lidars is source.rig.lidars
    check = RigCheck(used.rig, used.config, used.compared)
    [warning] = check.warnings
    assert "lies beside" in warning.finding
    assert "moves" not in warning.remedy
    assert check.corrected().lidars != used.rig.lidars


def test_lidars_are_not_compared_where_the_rig_moves_unnoticed(crossing: RunInput) -> None:
    moving = replace(with_second_lidar(crossing, 0.5), settings=UsedSettings("road", "judged", moves=True))
    with patch("lidcam.run.first_look.MAX_APART_NS", -1):
        assert [pair.error for pair in with_agreeing_lidars(moving).compared.pairs] == [None]
    assert with_agreeing_lidars(crossing) is crossing  # one lidar


def test_parts_of_the_cloud_of_a_result_are_not_compared(tmp_path: Path) -> None:
    """The ground, and what is above it: they have no surface in common."""
    lidcam.process(CROSSING, tmp_path / "out.mcap", settings=SETTINGS, duration_s=0.7)
    with open_recording([tmp_path / "out.mcap"]) as recording:
        rig = discover_rig(recording, Config()).rig
        source = RunInput(recording, rig, Config())
        assert [lidar.topic for lidar in rig.lidars] == ["/ground_cloud", "/point_cloud_combined"]
        assert with_agreeing_lidars(source) is source


@pytest.mark.parametrize("frames", [1, 2, 17, 18, 200, 100_000])
def test_stretches_are_a_share_of_the_recording(frames: int) -> None:
    start_ns, period_ns = 1_700_000_000_000_000_003, 100_000_000
    stop_ns = start_ns + frames * period_ns
    starts_ns = [start_ns, *later_stretches(start_ns, stop_ns, period_ns)]
    assert len(starts_ns) == max(1, min(frames // 9, 20))
    assert all(second - first >= STRETCH_FRAMES * period_ns for first, second in pairwise(starts_ns))
    assert len(starts_ns) == 1 or starts_ns[-1] + STRETCH_FRAMES * period_ns <= stop_ns


def test_a_run_looks_for_each_box_once_and_counts_each_message_once() -> None:
    with patch.object(Detect3D, "__call__", autospec=True, side_effect=Detect3D.__call__) as detect:
        first = lidcam.process(CROSSING, settings=SETTINGS, duration_s=0.7).summary
    assert detect.call_count == first.frames.count > 1
    second = lidcam.process(CROSSING, settings=SETTINGS | {"fuse.calibration": "recorded"}, duration_s=0.7).summary
    assert first.inputs.messages_used == second.inputs.messages_used
    assert first.drops.messages == second.drops.messages


def test_a_lidar_may_end_with_the_first_stretch(crossing: RunInput) -> None:
    with patch("lidcam.run.first_look.later_stretches", side_effect=[[crossing.recording.end_ns]]) as asked:
        lidcam.process(CROSSING, settings=SETTINGS, duration_s=0.7)
    asked.assert_called_once()


def test_boxes_in_images_are_taken_over_with_the_stamps_of_the_run() -> None:
    [frame], no_detector = passing(frames=1), Mock(side_effect=AssertionError("asked"))
    known, rig = KnownBoxes(), replace(RIG, cameras=(CAMERA,))
    known.keep(rig, frame)
    later = Decoded({"cam": Image(17, "cam", np.zeros((4, 4, 3), np.uint8))})
    found = known.in_images(rig, no_detector, None, frame.bundle, later, frame.combined)
    np.testing.assert_array_equal(found["cam"].xyxy, frame.detections.cameras["cam"].xyxy)
    assert found["cam"].stamp_ns == 17
    with pytest.raises(AssertionError, match="asked"):
        known.in_images(rig, no_detector, None, replace(frame.bundle, stamp_ns=1), later, frame.combined)
