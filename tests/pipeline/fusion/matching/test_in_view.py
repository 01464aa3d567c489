from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera
from hypothesis import assume, given
from hypothesis import strategies as st

from pipeline.core.arrays import F32
from pipeline.core.camera import NEAR_M
from pipeline.core.detections import Boxes3D
from pipeline.core.errors import FrameError
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor
from pipeline.fusion.matching.in_view import InView, project_into_views
from pipeline.fusion.projection import CameraArrays

RIGHT = np.array([[-1.0, 0, 0, 0], [0, 0, -1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
LENS = forward_camera("lens", distortion=[-0.2, 0.05, 0.001, -0.002, 0.01])
FISHEYE = replace(
    forward_camera("fisheye"),
    model=replace(forward_camera("fisheye").model, model="equidistant", K=LENS.model.K.copy()),
)
ASIDE = replace(forward_camera("right"), T_camera_site=Transform("right", "site", RIGHT))
CAMERAS = (forward_camera(), LENS, FISHEYE, ASIDE)


def project(boxes: Boxes3D, cameras: tuple[CameraSensor, ...] = CAMERAS) -> InView:
    return project_into_views(boxes, cameras, CameraArrays.of(cameras))


def by_camera(boxes: Boxes3D, camera: CameraSensor) -> F32:
    return camera.project_boxes(box_corners(boxes.centers, boxes.sizes, boxes.yaws), "site")


lengths = st.floats(0.3, 12)
rows = st.tuples(*[st.floats(-30, 30)] * 2, st.floats(-2, 2), lengths, lengths, st.floats(0.3, 4), st.floats(-3, 3))


@given(st.lists(rows, max_size=4))
def test_rectangles_are_those_of_each_camera(table: list[tuple[float, ...]]) -> None:
    boxes = boxes3d(table)
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    for camera in CAMERAS:  # of what is as near as that, one is cut where the other is not
        depths = camera.T_camera_site.apply(corners)[..., 2]
        assume(not ((depths > 0) & (depths < NEAR_M)).any())
    seen = project(boxes)
    found = np.full((len(CAMERAS), len(boxes), 4), np.nan)
    found[seen.cameras, seen.rows] = seen.xyxy
    for camera, rectangles in zip(CAMERAS, found, strict=True):
        np.testing.assert_allclose(rectangles, by_camera(boxes, camera), atol=1e-3)
    assert (np.diff(seen.cameras * 10 + seen.rows) > 0).all()


def test_ranges_and_derivatives() -> None:
    boxes = boxes3d([(10, 2, 0, 4, 2, 1.5, 0.3), (3, -4, 0, 4, 2, 1.5, 0.3)])
    seen = project(boxes, (forward_camera(),))
    assert seen.ranges_m.tolist() == pytest.approx([np.hypot(10, 2), 5])
    step = 1e-5
    for parameter in range(3):
        centers, yaws = boxes.centers.copy(), boxes.yaws.copy()
        if parameter < 2:
            centers[:, parameter] += step
        else:
            yaws += step
        camera = forward_camera()
        moved = camera.model.project(camera.T_camera_site.apply(box_corners(centers, boxes.sizes, yaws)))[0]
        still = camera.model.project(camera.T_camera_site.apply(box_corners(boxes.centers, boxes.sizes, boxes.yaws)))[0]
        low, high = moved.min(1) - still.min(1), moved.max(1) - still.max(1)
        slope = np.concatenate([low, high], 1) / step
        assert seen.jacobian[0, :, parameter] == pytest.approx(slope[0], abs=0.05)
        assert seen.jacobian[1, 0, parameter] == pytest.approx(slope[1, 0], abs=0.5)
    assert seen.xyxy[1, 2] == 640
    assert not seen.jacobian[1, [1, 2]].any(), "the border of the image does not move"


def test_a_box_beside_the_camera_is_cut_and_has_no_derivatives() -> None:
    seen = project(boxes3d([(0, 1.5, 0, 10, 1, 1.5, 0.0)]), (forward_camera(),))
    assert len(seen) == 1
    assert not seen.jacobian.any()


def test_nothing() -> None:
    assert len(project(boxes3d([]))) == 0
    assert len(project(boxes3d([(10, 0, 0, 4, 2, 1.5, 0)]), ())) == 0


def test_boxes_in_another_frame_are_refused() -> None:
    with pytest.raises(FrameError, match="camera cam: expected boxes in frame 'site', found 'odom'"):
        project(boxes3d([], frame_id="odom"))
