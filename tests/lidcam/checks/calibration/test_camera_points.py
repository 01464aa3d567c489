"""A camera without a lidar point in its image is named."""

from dataclasses import replace

import numpy as np
import pytest
from detections import forward_camera
from frames import RIG

from lidcam.checks.calibration.camera_points import MAX_CLOUDS, CameraPoints
from lidcam.pipeline.core.arrays import F32
from lidcam.pipeline.core.rig import Rig

MANY = 600
AHEAD = np.repeat(np.array([[10, 0, 0], [12, 1, 0.5]], np.float32), MANY, 0)
BEHIND = AHEAD * np.float32(-1)
RIG_OF_TWO = replace(RIG, cameras=(forward_camera("one"), forward_camera("two")))


def warned(rig: Rig, *clouds: F32) -> list[str]:
    check = CameraPoints(rig)
    for xyz in clouds:
        check.add(xyz)
    return [str(warning) for warning in check.warnings]


@pytest.mark.parametrize(
    ("clouds", "cameras"),
    [
        ([], 0),
        ([np.zeros((0, 3), np.float32)], 0),
        ([AHEAD], 0),
        ([BEHIND, AHEAD, BEHIND], 0),
        ([BEHIND], 2),
        ([BEHIND] * MAX_CLOUDS + [AHEAD], 2),
        ([BEHIND[:400]], 0),  # too few
        ([np.tile(np.array([[10, 0, 9]], np.float32), (MANY, 1))], 2),  # above the image
        ([np.tile(np.array([[10, 9, 0]], np.float32), (MANY, 1))], 2),  # left of it
    ],
)
def test_cameras_without_points(clouds: list[F32], cameras: int) -> None:
    lines = warned(RIG_OF_TWO, *clouds)
    assert [line.split(":")[0] for line in lines] == ["one", "two"][:cameras]
    assert warned(replace(RIG, cameras=()), *clouds) == []


def test_points_that_the_inverse_sees_are_counted() -> None:
    assert warned(RIG_OF_TWO, BEHIND)[0] == (
        "one: none of 1200 lidar points of 1 clouds falls into its image; check its extrinsics and the frame that they "
        "are given in"
    )
    beside = np.tile(np.array([[0, -10, 0]], np.float32), (MANY, 1))
    assert warned(RIG_OF_TWO, beside)[0] == (
        "one: none of 600 lidar points of 1 clouds falls into its image (600 do with the inverse of its extrinsics); "
        "check its extrinsics and the frame that they are given in, and whether T_camera_site (site to camera) and "
        "T_site_camera are mixed up"
    )


def test_large_clouds_are_thinned() -> None:
    check = CameraPoints(RIG_OF_TWO)
    check.add(np.repeat(BEHIND, 10, 0))
    assert "none of 3000 lidar points" in str(check.warnings[0])
