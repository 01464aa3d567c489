from functools import cache

import numpy as np
import pytest

from lidcam.bags.simulator.sensors.lens import Lens
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel, DistortionModel

LENSES: dict[str, tuple[DistortionModel, tuple[float, ...], float]] = {
    "none": ("plumb_bob", (0.0,) * 5, 500.0),
    "barrel": ("plumb_bob", (-0.30, 0.11, 0.0007, -0.0004, -0.02), 420.0),
    "pincushion": ("plumb_bob", (0.12, 0.02, -0.001, 0.001, 0.0), 500.0),
    "rational": ("rational_polynomial", (5.1, 2.3, 1e-4, -2e-4, 0.09, 5.4, 3.9, 0.6), 430.0),
    "fisheye": ("equidistant", (-0.02, 0.004, -0.002, 0.0003), 290.0),
}


@cache
def lens_of(name: str) -> Lens:
    kind, distortion, focal = LENSES[name]
    matrix = np.array([[focal, 0, 322.1], [0, focal + 1.5, 238.7], [0, 0, 1.0]])
    return Lens(CameraModel("optical", 640, 480, matrix, kind, np.array(distortion)))


def pixel_centers() -> F64:
    rows, columns = np.divmod(np.arange(640 * 480), 640)
    return np.stack([columns + 0.5, rows + 0.5], 1)


@pytest.mark.parametrize("name", LENSES)
def test_rays_come_back_to_their_pixels(name: str) -> None:
    lens = lens_of(name)
    pixels, valid = lens.model.project(3.7 * lens.directions[lens.covered])
    assert valid.all()
    assert np.abs(pixels - pixel_centers()[lens.covered]).max() < 0.01
    np.testing.assert_allclose(np.linalg.norm(lens.directions, axis=1), 1.0, atol=1e-6)
    assert lens.covered.mean() > 0.95


def test_pixels_outside_of_the_image_circle_are_not_covered() -> None:
    matrix = np.array([[150.0, 0, 319.5], [0, 150.0, 239.5], [0, 0, 1.0]])
    lens = Lens(CameraModel("optical", 640, 480, matrix, "equidistant", np.zeros(4)))
    circle = np.hypot(*(pixel_centers() - (320, 240)).T) < 150 * np.pi / 2 + 1
    covered = lens.covered
    assert not covered[~circle].any()  # the model knows no rays from behind
    assert covered[np.hypot(*(pixel_centers() - (320, 240)).T) < 150 * 1.5].all()
    assert np.isfinite(lens.directions).all()


@pytest.mark.parametrize("name", LENSES)
def test_window_holds_every_pixel_that_looks_into_a_hull(name: str) -> None:
    lens = lens_of(name)
    random = np.random.default_rng(5)
    for _ in range(15):
        middle = random.uniform([-3, -2, -1.0], [3, 2, 8.0])
        points = middle + random.uniform(-1, 1, (8, 3)) * random.uniform(0.1, 1.5, 3)
        shares = random.dirichlet(np.full(8, 0.4), 400)  # inside of the hull, many near its corners and edges
        pixels, valid = lens.model.project(shares @ points)
        seen = valid & (pixels >= 0).all(1) & (pixels < (640, 480)).all(1) & ((shares @ points)[:, 2] > 0.02)
        left, top, right, bottom = lens.window(points)
        inside = (pixels >= (left, top)).all(1) & (pixels <= (right, bottom)).all(1)
        assert (inside | ~seen).all()
        shown = np.zeros(640 * 480, np.bool_)
        if right > left and bottom > top:
            shown[lens.hull(points, (left, top, right, bottom))] = True
        column, row = np.floor(pixels[seen]).astype(int).T
        assert shown[row * 640 + column].all()
