import numpy as np
import pytest
from detections import forward_camera, mounted
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.optics.upright import TURNS, quarter_turns, turned

SIZE_PX = (12, 7)
boxes = st.tuples(st.integers(0, 10), st.integers(0, 5), st.integers(1, 12), st.integers(1, 7)).filter(
    lambda box: box[0] < box[2] and box[1] < box[3]
)


@given(boxes, st.integers(0, 3))
def test_boxes_turn_as_images_do(box: tuple[int, int, int, int], quarters: int) -> None:
    shown = np.zeros(SIZE_PX[::-1])
    shown[box[1] : box[3], box[0] : box[2]] = 1
    rows, columns = np.nonzero(np.rot90(shown, quarters))
    found = turned(np.array([box], np.float64), np.array([quarters]), np.array([SIZE_PX], np.float64))
    assert found[0].tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("tilt_deg", [-40, 0, 40])
def test_turns_of_mounted_cameras(quarters: int, tilt_deg: float) -> None:
    roll, level = np.eye(4), forward_camera()
    angle = np.radians(tilt_deg)
    roll[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    rotation = roll[:3, :3] @ mounted(level, quarters).T_camera_site.matrix[:3, :3]
    assert quarter_turns(rotation[None]).tolist() == [quarters]
    upright = roll[:3, :3] @ level.T_camera_site.matrix[:3, :3]
    np.testing.assert_allclose(TURNS[quarters] @ rotation, upright, atol=1e-9)


def test_cameras_that_look_down_are_not_turned() -> None:
    straight_down = Transform("cam", "site", np.diag([-1.0, 1, -1, 1]))
    assert quarter_turns(straight_down.matrix[None, :3, :3]).tolist() == [0]
    assert quarter_turns(np.zeros((0, 3, 3))).tolist() == []
