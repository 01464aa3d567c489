"""A camera whose pose is off by degrees is turned to where its 2D boxes fit; one that fits, or shows little, stays."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera

from lidcam.pipeline.calibration.overlap import BoxFrame, camera_that_fits, turned_pose, used_if_it_fits
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraFit, CameraSensor

CAMERA = forward_camera("front")
CAR = (4.2, 1.8, 1.5)


def cars(number: int, count: int = 8) -> F64:
    """(N, 7) boxes of cars ahead."""
    random = np.random.default_rng(number)
    place = random.uniform((14, -12, -0.9, -3), (40, 12, -0.8, 3), (count, 4))
    return np.asarray(np.c_[place[:, :3], np.tile(CAR, (count, 1)), place[:, 3]])


def seen(rows: F64, *, beyond: int = 0, class_id: int = 0) -> BoxFrame:
    """The cars and their 2D boxes, of which the lidars miss those `beyond`."""
    found = boxes3d(rows, scores=np.full(len(rows), 0.8))
    corners = box_corners(found.centers, found.sizes, found.yaws)
    xyxy = CAMERA.model.project_boxes(np.asarray(CAMERA.T_camera_site.apply(corners), np.float64))
    xyxy = xyxy[np.isfinite(xyxy).all(1)]
    return BoxFrame(found.select(np.arange(len(rows)) >= beyond), xyxy, np.full(len(xyxy), class_id, np.int32))


def turned(yaw_deg: float, pitch_deg: float) -> CameraSensor:
    pose = replace(CAMERA.T_camera_site, matrix=turned_pose(CAMERA, yaw_deg, pitch_deg))
    return replace(CAMERA, T_camera_site=pose)


def angle_deg(first: CameraSensor, second: CameraSensor) -> float:
    turn = first.T_camera_site.matrix[:3, :3] @ second.T_camera_site.matrix[:3, :3].T
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


FRAMES = [seen(cars(number)) for number in range(10)]


@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(4.3, 0), (-6, 1), (0, -4), (7.4, 5)])
@pytest.mark.parametrize("beyond", [0, 4], ids=["all by lidars", "half"])
def test_a_camera_that_is_off_by_degrees_is_turned(yaw_deg: float, pitch_deg: float, beyond: int) -> None:
    calibrated = turned(yaw_deg, pitch_deg)
    frames = [seen(cars(number), beyond=beyond) for number in range(10)]
    camera = camera_that_fits(calibrated, frames)
    assert angle_deg(camera, CAMERA) < 0.9
    np.testing.assert_allclose(np.degrees(camera.fit.corrected[:2]), [-pitch_deg, -yaw_deg], atol=0.8)
    assert camera_that_fits(camera, frames) is camera


@pytest.mark.parametrize("roll_deg", [-7.6, 8.0])
def test_a_camera_that_is_rolled_is_turned(roll_deg: float) -> None:
    pose = replace(CAMERA.T_camera_site, matrix=turned_pose(CAMERA, 0, 0, roll_deg))
    camera = camera_that_fits(replace(CAMERA, T_camera_site=pose), FRAMES)
    assert angle_deg(camera, CAMERA) < 0.9
    assert camera.model is CAMERA.model
    assert np.degrees(camera.fit.corrected[2]) == pytest.approx(-roll_deg, abs=0.8)


@pytest.mark.parametrize("zoom", [0.72, 0.75, 1.3, 1.35])
def test_the_focal_length_of_another_lens_is_corrected(zoom: float) -> None:
    camera = camera_that_fits(replace(CAMERA, model=CAMERA.model.zoomed(zoom)), FRAMES)
    assert camera.model.K[1, 1] == pytest.approx(CAMERA.model.K[1, 1], rel=0.05)
    np.testing.assert_array_equal(camera.model.K[:2, 2], CAMERA.model.K[:2, 2])
    assert camera.fit.zoom == pytest.approx(1 / zoom, rel=0.05)
    assert camera.T_camera_site.matrix.tolist() == CAMERA.T_camera_site.matrix.tolist()
    assert camera_that_fits(camera, FRAMES) is camera


SPARSE = [seen(cars(number), beyond=7) for number in range(10)]
STILL = [seen(cars(0, 3))] * 10


@pytest.mark.parametrize(
    ("camera", "frames"),
    [
        pytest.param(CAMERA, FRAMES, id="sound"),
        pytest.param(turned(1, 0), FRAMES, id="off by a degree, which pairs show"),
        pytest.param(replace(CAMERA, model=CAMERA.model.zoomed(1.04)), FRAMES, id="focal length nearly right"),
        pytest.param(turned(30, 0), FRAMES, id="off by more than a hand-made pose"),
        pytest.param(turned(5, 0), FRAMES[:4], id="few frames"),
        pytest.param(turned(5, 0), STILL, id="three parked cars"),
        pytest.param(turned(5, 0), [], id="none"),
        pytest.param(CAMERA, SPARSE, id="most cars beyond the lidars"),
        pytest.param(replace(turned(5, 0), fit=CameraFit(corrected=(0.0, 0.1, *[0.0] * 5))), FRAMES, id="corrected"),
    ],
)
def test_others_stay(camera: CameraSensor, frames: Sequence[BoxFrame]) -> None:
    assert camera_that_fits(camera, frames) is camera


AWAY = turned(0, 12)
UNSURE = [one._replace(objects=replace(one.objects, scores=np.full(8, 0.5, np.float32))) for one in FRAMES]


@pytest.mark.parametrize(
    ("camera", "frames", "is_used"),
    [
        pytest.param(AWAY, FRAMES, False, id="fits nowhere"),
        pytest.param(CAMERA, FRAMES, True, id="sound"),
        pytest.param(CAMERA, SPARSE, True, id="most cars beyond the lidars"),
        pytest.param(AWAY, UNSURE, True, id="nothing sure"),
        pytest.param(AWAY, [seen(cars(number), class_id=1) for number in range(10)], True, id="finds no cars"),
        pytest.param(
            AWAY, [seen(cars(number), beyond=8) for number in range(10)], True, id="looks where no lidar does"
        ),
        pytest.param(AWAY, FRAMES[:4], True, id="few frames"),
        pytest.param(AWAY, STILL, True, id="three parked cars"),
    ],
)
def test_a_camera_that_fits_nowhere_is_not_used(
    camera: CameraSensor, frames: Sequence[BoxFrame], *, is_used: bool
) -> None:
    camera = used_if_it_fits(camera, frames, frames)
    assert camera.fit.is_used == is_used
    assert used_if_it_fits(camera, frames, frames) is camera
    hidden = [one._replace(objects=one.objects.select(np.zeros(0, np.intp))) for one in frames]
    assert used_if_it_fits(AWAY, frames, hidden) is AWAY
