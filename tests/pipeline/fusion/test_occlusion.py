import numpy as np
import pytest
from detections import forward_camera

from pipeline.fusion.occlusion import MAX_POINTS, DepthPicture, sampled

VIEW = forward_camera()  # 640 x 480 px, f = 500 px, looks along x
WHOLE = np.array([[220.0, 140, 420, 340]], np.float32)  # 4 m wide and high at 10 m


def wall(x_m: float, y_m: tuple[float, float] = (-2.0, 2.0), z_m: tuple[float, float] = (-2.0, 2.0)) -> np.ndarray:
    y, z = np.meshgrid(np.linspace(*y_m, 60), np.linspace(*z_m, 60))
    return np.stack([np.full(y.size, x_m), y.ravel(), z.ravel()], 1).astype(np.float32)


@pytest.mark.parametrize(
    ("points", "low", "high"),
    [
        (np.zeros((0, 3), np.float32), 0.0, 0.0),
        (wall(5.0), 0.95, 1.0),
        (wall(15.0), 0.0, 0.0),
        (wall(9.9), 0.0, 0.0),  # its own points
        (-wall(5.0), 0.0, 0.0),  # behind the camera
        (wall(5.0, (-10.0, -3.0)), 0.0, 0.0),  # beside it
        (np.concatenate([wall(5.0, (0.0, 1.0), (-1.0, 1.0)), wall(10.0)]), 0.4, 0.65),
        (np.array([[5.0, 0, 0]], np.float32), 0.5, 0.5),  # one point does not hide all
    ],
    ids=["nothing", "in front", "behind", "on it", "behind the camera", "beside", "half", "one point"],
)
def test_what_is_nearer_hides(points: np.ndarray, low: float, high: float) -> None:
    (share,) = DepthPicture.of(VIEW, points).hidden(WHOLE, np.array([10.0]))
    assert low <= share <= high


def test_small_objects_take_the_cell_that_they_lie_in() -> None:
    picture = DepthPicture.of(VIEW, wall(5.0))
    tiny = np.array([[320.0, 240, 320, 240], [640, 480, 640, 480], [0, 0, 0.5, 0.5]], np.float32)
    assert (picture.hidden(tiny, np.full(3, 10.0)) > 0).tolist() == [True, False, False]


def test_a_lens_that_bends_lines_is_followed() -> None:
    bent = forward_camera(distortion=(-0.3, 0.1))
    corner = np.array([[5.0, 2.5, 1.8]], np.float32)
    (pixel,), _ = bent.model.project(np.asarray(bent.T_camera_site.apply(corner)))
    rectangle = np.concatenate([pixel - 5, pixel + 5])[None].astype(np.float32)
    assert DepthPicture.of(bent, corner).hidden(rectangle, np.array([10.0]))[0] == 0.5


@pytest.mark.parametrize("count", [0, 1, MAX_POINTS, MAX_POINTS + 1, 3 * MAX_POINTS + 7])
def test_points_are_chosen_evenly(count: int) -> None:
    points = np.arange(3 * count, dtype=np.float32).reshape(-1, 3)
    chosen = sampled(points)
    assert min(count, MAX_POINTS // 2) <= len(chosen) <= MAX_POINTS
    assert len(np.unique(np.diff(chosen[:, 0]))) <= 1
