"""The part of a large image that the network sees once more, and what becomes of its boxes."""

from dataclasses import replace

import numpy as np
import pytest
from detections import forward_camera
from lidar_scene import combined

from lidcam.pipeline.core.clouds import CombinedCloud, Plane
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.detectors.far_view import PERSON_PX, FarView, far_view
from lidcam.pipeline.detectors.onnx.tiles import Tile
from lidcam.pipeline.detectors.protocols import Candidates2D

MEGAPIXEL = 1_000_000
PERSON_M = 1.75
WIDE_PX, HIGH_PX = 4000, 3000
GROUND = combined(np.zeros((0, 3)), plane=Plane(np.array([0.0, 0.0, 1.0]), 1.5))
"""Level ground 1.5 m below the camera."""


def camera(
    focal_px: float = 2000.0, pitch_rad: float = 0.0, size_px: tuple[int, int] = (WIDE_PX, HIGH_PX)
) -> CameraSensor:
    level = forward_camera(size_px=size_px)
    K = level.model.K.copy()
    K[0, 0] = K[1, 1] = focal_px
    down = np.eye(4)
    down[1:3, 1:3] = [[np.cos(pitch_rad), -np.sin(pitch_rad)], [np.sin(pitch_rad), np.cos(pitch_rad)]]
    pose = Transform(level.name, "site", down @ level.T_camera_site.matrix)
    return replace(level, model=replace(level.model, K=K), T_camera_site=pose)


def view_of(one: CameraSensor, ground: CombinedCloud = GROUND) -> FarView | None:
    return far_view(one, ground, person_m=PERSON_M, level_m=-1.5, max_px=MEGAPIXEL)


@pytest.mark.parametrize("pitch_rad", [0.0, 0.1])
@pytest.mark.parametrize("ground", [GROUND, combined(np.zeros((0, 3)))], ids=["a plane", "no ground found"])
def test_it_shows_whoever_is_too_small_in_the_whole_image(pitch_rad: float, ground: CombinedCloud) -> None:
    one = camera(pitch_rad=pitch_rad)
    view = view_of(one, ground)
    assert view is not None
    scale = (MEGAPIXEL / (WIDE_PX * HIGH_PX)) ** 0.5
    near_m = 2000 * PERSON_M * scale / PERSON_PX
    for x_m in np.linspace(near_m, 39, 5):
        for z_m in (-1.5, PERSON_M - 1.5):
            (pixel,), _ = one.model.project(one.T_camera_site.apply(np.array([[x_m, 0.0, z_m]])))
            assert (pixel >= view.part[:2]).all()
            assert (pixel <= view.part[2:]).all()
    left, top, right, bottom = view.part
    assert (left, right) == (0, WIDE_PX)
    assert bottom - top < HIGH_PX / 5, "not the sky, not the road before the camera"
    assert view.max_height_px == pytest.approx(PERSON_PX / scale)


@pytest.mark.parametrize(
    "one",
    [
        pytest.param(camera(focal_px=20_000), id="large enough as far as it matters"),
        pytest.param(camera(size_px=(1242, 375)), id="an image that is given in its own size"),
        pytest.param(camera(pitch_rad=-np.pi / 2), id="a camera that looks up"),
    ],
)
def test_no_part_is_shown_without_need(one: CameraSensor) -> None:
    assert view_of(one) is None


def boxes(*rows: tuple[float, float, float, float]) -> Candidates2D:
    table = np.array(rows, np.float32).reshape(-1, 4)
    return Candidates2D(table, np.full(len(table), 0.5, np.float32), np.arange(len(table)))


def test_small_boxes_are_those_of_the_part() -> None:
    """Below and above it, and where they are large, they are those of the whole image."""
    view, image = FarView(Tile(0, 100, 200, 200), 40), Tile(0, 0, 200, 300)
    small, large, beside = (50, 130, 60, 160), (20, 110, 90, 190), (50, 250, 60, 280)
    in_part, cut, too_large = (80, 20, 90, 50), (120, 60, 130, 100), (20, 10, 90, 90)
    found = view.join(boxes(small, large, beside), boxes(in_part, cut, too_large), image)
    assert found.xyxy.tolist() == [[*large], [*beside], [80, 120, 90, 150]]
    assert found.labels.tolist() == [1, 2, 0]
