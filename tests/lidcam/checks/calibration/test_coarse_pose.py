"""A camera with a grossly wrong pose is named, with the pose that fits; a good one never is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera
from frames import RIG, frame
from scipy.spatial.transform import Rotation
from seen_boxes import seen_by

from lidcam.checks.calibration.rig_check import FITS_NOWHERE, REMEDY, UNUSED, RigCheck
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Detections
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.calibration import OPTICAL_OF_BODY

CAR = (4.2, 1.8, 1.5)


def posed(camera: CameraSensor, matrix: F64) -> CameraSensor:
    return replace(camera, T_camera_site=Transform(camera.T_camera_site.dst, camera.T_camera_site.src, matrix))


def turned(camera: CameraSensor, axis: str, angle_deg: float) -> CameraSensor:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    return posed(camera, turn @ camera.T_camera_site.matrix)


def raised(camera: CameraSensor) -> CameraSensor:
    """The camera 2 m up and 3 m aside, so that its pose is not its own inverse."""
    shift = np.eye(4)
    shift[:3, 3] = -3, 1, -2
    return posed(camera, camera.T_camera_site.matrix @ shift)


TRUE = raised(forward_camera("front"))
REAR = turned(raised(forward_camera("rear")), "y", 180)


def rig(*cameras: CameraSensor) -> Rig:
    return replace(RIG, lidars=(), cameras=cameras)


def seen(number: int, *cameras: CameraSensor, objects: int = 3) -> FrameResult:
    """A frame in which each camera has boxes of all objects in its view."""
    random = np.random.default_rng(number)
    aside = random.uniform(-14, 14, objects)
    ahead = random.uniform(14, 40, objects) * np.where(np.arange(objects) % 2, -1, 1)
    rows = [(x, y, 0.7, *CAR, yaw) for x, y, yaw in zip(ahead, aside, random.uniform(-3, 3, objects), strict=True)]
    boxes = {camera.name: seen_by(camera, rows, [0] * objects, score=0.9) for camera in cameras}
    return replace(frame(), detections=Detections(boxes3d(rows), boxes))


def warned(calibrated: Rig, frames: Sequence[FrameResult]) -> list[str]:
    check = RigCheck(calibrated, Config())
    for result in frames:
        check.add_frame(result)
    return [str(warning) for warning in check.warnings]


FRAMES = [seen(number, TRUE, REAR, objects=8) for number in range(12)]


def test_cameras_as_calibrated_are_not_named() -> None:
    assert warned(rig(TRUE, REAR), FRAMES) == []


@pytest.mark.parametrize(
    ("camera", "how"),
    [
        (turned(TRUE, "y", -20), "if it looked 20 degrees further left; calibrate it again"),
        (turned(TRUE, "x", -10), "if it looked 10 degrees further down; calibrate it again"),
        (turned(TRUE, "z", 180), "if it were rolled by 180 degrees; check how its mount"),
        (turned(TRUE, "z", -90), "if it were rolled by 90 degrees counter-clockwise; check how its mount"),
        (posed(TRUE, OPTICAL_OF_BODY.T @ TRUE.T_camera_site.matrix), "with its extrinsics taken as those of its body"),
        (posed(TRUE, TRUE.T_camera_site.inverse().matrix), "with the inverse of its extrinsics; they look inverted"),
    ],
)
def test_the_pose_that_fits_is_named(camera: CameraSensor, how: str) -> None:
    [line] = warned(rig(camera), FRAMES)
    assert line.startswith("front: its ")
    assert "boxes overlap the objects of the lidars by" in line
    assert f", and by 100% {how}" in line


def test_a_lidar_whose_x_axis_points_aside() -> None:
    """Objects are where they would be if it pointed forward."""
    center = np.append(RIG.lidar_xyz.mean(0), 0)
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    quarter[:, 3] += center - quarter @ center
    wrong = replace(rig(posed(TRUE, TRUE.T_camera_site.matrix @ quarter)), lidars=RIG.lidars)
    [line] = warned(wrong, FRAMES)
    assert ", and by 100% if the lidars were turned by -90 degrees about z; check which way" in line


def test_cameras_with_each_others_extrinsics() -> None:
    front, rear = posed(TRUE, REAR.T_camera_site.matrix), posed(REAR, TRUE.T_camera_site.matrix)
    lines = warned(rig(front, rear), FRAMES)
    assert [line.split(":")[0] for line in lines] == ["front", "rear"]
    assert ", and by 100% with the extrinsics of rear; check which extrinsics, and which topics, belong" in lines[0]
    assert ", and by 100% with the extrinsics of front;" in lines[1]


def lasting(shift_px: float, every: int = 1) -> list[FrameResult]:
    """Boxes that move a little from image to image, in every nth image only."""
    boxes = FRAMES[0].detections.cameras["front"]
    moved = [replace(boxes, xyxy=boxes.xyxy + np.float32(number * shift_px)) for number in range(48)]
    found = [one if number % every == 0 else one.select(np.array([], np.intp)) for number, one in enumerate(moved)]
    return [replace(FRAMES[0], detections=replace(FRAMES[0].detections, cameras={"front": one})) for one in found]


@pytest.mark.parametrize(
    ("frames", "is_named"),
    [
        (lasting(0.1), True),
        # Passing false boxes are all that a detector finds where nothing drives, and a driver that repeats an image
        # says nothing new.
        (lasting(0.1, every=4), False),
        (lasting(0.0), False),
    ],
)
def test_a_camera_that_fits_with_no_pose_is_named(frames: Sequence[FrameResult], is_named: bool) -> None:
    away = posed(TRUE, turned(TRUE, "x", 90).T_camera_site.matrix)
    ending = "by 0% on average; check its intrinsics and extrinsics; or does it look where no lidar does?"
    assert [line.endswith(ending) for line in warned(rig(away), frames)] == [True] * is_named


def test_passing_false_boxes_do_not_hide_that_the_others_fit() -> None:
    """Four false boxes in each image, and one of a car, which fits by half."""

    def with_false_boxes(number: int, found: FrameResult) -> FrameResult:
        corners = np.random.default_rng(number).uniform(0, 440, (4, 2))
        car = found.detections.cameras["front"]
        width_px = car.xyxy[0, 2] - car.xyxy[0, 0]
        xyxy = np.concatenate([car.xyxy[:1] + [width_px / 3, 0] * 2, np.c_[corners, corners + 30]]).astype(np.float32)
        boxes = replace(car.select(np.zeros(5, np.intp)), xyxy=xyxy)
        return replace(found, detections=replace(found.detections, cameras={"front": boxes}))

    assert warned(rig(TRUE), [with_false_boxes(*one) for one in enumerate(lasting(0.1))]) == []


def test_a_camera_that_is_not_used_is_named() -> None:
    unused = posed(TRUE, turned(TRUE, "x", 90).T_camera_site.matrix)
    unused = replace(unused, fit=replace(unused.fit, is_used=False))
    [line] = warned(rig(unused), lasting(0.1))
    remedy = "check its intrinsics and extrinsics; or does it look where no lidar does?"
    assert line.endswith(f"by 0% on average; {UNUSED}; {remedy}")
    assert warned(rig(unused), []) == [f"front: {FITS_NOWHERE}; {UNUSED}; {REMEDY}"]


def test_boxes_of_a_larger_image_are_named() -> None:
    """A detector that ran on the full image, with the CameraInfo of a half-size one."""

    def scaled(result: FrameResult) -> FrameResult:
        boxes = result.detections.cameras["front"]
        cameras = {"front": replace(boxes, xyxy=2 * boxes.xyxy)}
        return replace(result, detections=replace(result.detections, cameras=cameras))

    [line] = warned(rig(TRUE), [scaled(result) for result in FRAMES])
    width, height = TRUE.model.width_px, TRUE.model.height_px
    assert f"px where its calibration is for images of {width} x {height} px; record the boxes in pixels of" in line


@pytest.mark.parametrize("share", [0.5, 1.2])
def test_wide_boxes_are_no_calibration_error(share: float) -> None:
    def widened(result: FrameResult) -> FrameResult:
        boxes = result.detections.cameras["front"]
        left, top, right, bottom = boxes.xyxy.T
        wide = np.stack([left - share * (right - left), top, right + share * (right - left), bottom], 1)
        return replace(result, detections=Detections(result.detections.lidar, {"front": replace(boxes, xyxy=wide)}))

    assert warned(rig(TRUE), [widened(result) for result in FRAMES]) == []


BOXLESS = [replace(one, detections=Detections(one.detections.lidar, {})) for one in FRAMES]


@pytest.mark.parametrize(
    "frames",
    [
        [],
        FRAMES[:4],
        [seen(number, TRUE, objects=1) for number in range(6)],
        [seen(number, TRUE, objects=0) for number in range(20)] + BOXLESS,
    ],
    ids=["no frames", "few frames", "few boxes", "no objects, no boxes"],
)
def test_too_few_boxes_give_no_warning(frames: list[FrameResult]) -> None:
    assert warned(rig(turned(TRUE, "x", 90)), frames) == []
