from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera
from pipeline.fusion.belief.occlusion import hidden_by_points

from pipeline.core.arrays import F32, F64
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor

VIEW = forward_camera()  # 640 x 480 px, f = 500 px, looks along x
PLATE = (10.0, 0.0, 0.0, 0.1, 4.0, 4.0, 0.0)


def wall(x_m: float, y_m: tuple[float, float] = (-2.0, 2.0), z_m: tuple[float, float] = (-2.0, 2.0)) -> F32:
    y, z = np.meshgrid(np.linspace(*y_m, 60), np.linspace(*z_m, 60))
    return np.stack([np.full(y.size, x_m), y.ravel(), z.ravel()], 1).astype(np.float32)


def hidden(points: F32, *rows: tuple[float, ...], views: tuple[CameraSensor, ...] = (VIEW,)) -> F64:
    boxes = boxes3d(rows)
    cameras, objects = np.nonzero(np.ones((len(views), len(rows))))
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    return hidden_by_points(views, points, corners, cameras, objects)


@pytest.mark.parametrize(
    ("points", "low", "high"),
    [
        (np.zeros((0, 3), np.float32), 0.0, 0.0),
        (wall(5.0), 0.95, 1.0),
        (wall(15.0), 0.0, 0.0),
        (wall(9.9), 0.0, 0.0),
        (-wall(5.0), 0.0, 0.0),
        (wall(5.0, (-10.0, -3.0)), 0.0, 0.0),
        (np.concatenate([wall(5.0, (0.0, 1.0), (-1.0, 1.0)), wall(10.0)]), 0.4, 0.65),
        (np.array([[5.0, 0, 0]], np.float32), 0.5, 0.5),
    ],
    ids=[
        "nothing",
        "in front",
        "behind",
        "on it",
        "behind the camera",
        "beside",
        "half",
        "one point does not hide all",
    ],
)
def test_what_is_nearer_hides(points: F32, low: float, high: float) -> None:
    (share,) = hidden(points, PLATE)
    assert low <= share <= high


def test_small_objects_take_the_cell_that_they_lie_in() -> None:
    shares = hidden(wall(5.0), (10.0, 0, 0, 0.01, 0.01, 0.01, 0), (10.0, 6.0, 4.5, 0.01, 0.01, 0.01, 0))
    assert (shares > 0).tolist() == [True, False]


def test_objects_beside_and_behind_the_camera_are_hidden_by_nothing_but_do_no_harm() -> None:
    shares = hidden(wall(5.0), (-10.0, 0, 0, 4, 2, 2, 0), (0.0, 20, 0, 4, 2, 2, 0), (0.0, 0, 0, 4, 2, 2, 0))
    assert np.isfinite(shares).all()
    assert (shares[1:] == 0).all()


def test_each_camera_has_its_own_view() -> None:
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    backward = replace(VIEW, T_camera_site=Transform("cam", "site", VIEW.T_camera_site.matrix @ turned))
    behind = (-10.0, *PLATE[1:])
    shares = hidden(wall(5.0), PLATE, behind, views=(VIEW, backward)).reshape(2, 2)
    assert shares[0, 0] > 0.9
    assert shares[1, 1] == 0
    np.testing.assert_array_equal(
        hidden(-wall(5.0), PLATE, behind, views=(VIEW, backward)).reshape(2, 2)[1, 1] > 0.9, True
    )


def test_many_points_are_looked_at_evenly() -> None:
    dense = np.repeat(wall(5.0), 20, axis=0)
    assert hidden(dense, PLATE)[0] == pytest.approx(hidden(wall(5.0), PLATE)[0], abs=0.05)


def test_no_pairs() -> None:
    none = np.zeros(0, np.intp)
    assert hidden_by_points((), wall(5.0), np.zeros((0, 8, 3)), none, none).shape == (0,)
