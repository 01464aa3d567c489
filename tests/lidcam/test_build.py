"""What is decided before the stages of a frame are made."""

from dataclasses import replace

import pytest
from lidar_scene import rig
from seen_boxes import camera_at

from lidcam.build import decided
from pipeline.core.settings.load import load_config

LIDARS = rig((0.0, 0.0, 1.8))
CAMERA = replace(camera_at("front", (0.0, 0.0, 1.5)), boxes_topic="/front/boxes")


@pytest.mark.parametrize(
    ("settings", "preset", "has_camera", "score"),
    [
        ((), "road", False, "learned"),
        ((), "road", True, "geometric"),
        (("detect2d.method=none",), "road", True, "learned"),
        ((), "crossing", False, "learned"),
        ((), "sandbox", False, "geometric"),
        (("detect3d.score=learned",), "road", True, "learned"),
        (("detect3d.score=geometric",), "road", False, "geometric"),
        (("detect3d.weights=mine.npz",), "road", True, "learned"),
        (("detect3d.weights=mine.npz",), "sandbox", True, "learned"),  # an error that names the classes follows
    ],
)
def test_where_the_score_of_clusters_is_learned(
    settings: tuple[str, ...], preset: str, has_camera: bool, score: str
) -> None:
    config = load_config(preset, settings)
    assert decided(config, replace(LIDARS, cameras=(CAMERA,) if has_camera else ())).detect3d.score == score


@pytest.mark.parametrize(
    ("settings", "preset", "method"),
    [
        ((), "road", "cluster"),
        (("detect3d.model=mine.onnx",), "road", "combined"),
        (("detect3d.model=mine.onnx",), "sandbox", "pillars"),  # whose classes the learned score does not know
        (("detect3d.model=mine.onnx", "detect3d.method=pillars"), "road", "pillars"),
        (("detect3d.method=none",), "road", "none"),
    ],
)
def test_what_finds_boxes(settings: tuple[str, ...], preset: str, method: str) -> None:
    assert decided(load_config(preset, settings), LIDARS).detect3d.method == method
