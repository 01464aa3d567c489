from collections.abc import Sequence

import numpy as np
import pytest
from detections import boxes3d, forward_camera

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.fusion.projection import CameraArrays
from lidcam.pipeline.fusion.refining.edges import moved_by_borders

Box = tuple[float, float, float, float, float, float, float]


def moved(*places: Box) -> F64:
    camera = forward_camera()
    return moved_by_borders(boxes3d(places), np.arange(len(places)), CameraArrays.of([camera] * len(places)))


def shown(place: Box) -> F64:
    """Extent of all points of the surface of a box that lie in the image, by brute force."""
    camera, boxes = forward_camera(), boxes3d([place])
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)[0]
    share = np.linspace(0, 1, 400)[:, None]
    # Every line between two corners lies within the rectangle's hull, so all of them together show its border.
    points = np.concatenate([a + share * (b - a) for a in corners for b in corners])
    matrix = camera.T_camera_site.matrix
    seen = points @ matrix[:3, :3].T + matrix[:3, 3]
    pixels = seen @ camera.model.K.T
    uv = pixels[:, :2] / pixels[:, 2:] + 0.5
    size = np.array([camera.model.width_px, camera.model.height_px])
    left_right = uv[(uv[:, 1] >= 0) & (uv[:, 1] <= size[1])]
    top_bottom = uv[(uv[:, 0] >= 0) & (uv[:, 0] <= size[0])]
    inside = [left_right[:, 0].min(), top_bottom[:, 1].min(), left_right[:, 0].max(), top_bottom[:, 1].max()]
    moved_px: F64 = np.abs(np.array(inside) - [*uv.min(0), *uv.max(0)])
    return moved_px


@pytest.mark.parametrize(
    "place",
    [
        (9.0, 4.5, -0.2, 12.0, 2.5, 3.2, 0.4),
        (9.0, -4.5, 0.2, 12.0, 2.5, 3.2, -0.5),
        (9.0, 1.0, -4.0, 7.0, 2.5, 0.5, 0.7),
        (9.0, 1.0, 4.0, 7.0, 2.5, 0.5, 2.3),
    ],
)
def test_edges_are_those_of_what_is_in_the_image(place: Box) -> None:
    found, expected = moved(place)[0], shown(place)
    assert expected.max() > 10
    np.testing.assert_allclose(found, expected, atol=2.5)


def test_what_is_beyond_a_border_shows_nothing() -> None:
    above: Sequence[float] = moved((10, 0, 30, 4, 1.8, 1.5, 0.0))[0]
    assert above[0] > 100
    assert above[2] == pytest.approx(above[0])
