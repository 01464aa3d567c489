"""What is decided before the stages of a frame are made."""

from dataclasses import replace
from pathlib import Path

import pytest
from lidar_scene import rig
from seen_boxes import camera_at

from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.pillars.embedded import EMBEDDED
from lidcam.run.box_sources import boxes_2d_words
from lidcam.run.build import decided

LIDARS = rig((0.0, 0.0, 1.8))
UNKNOWN_CLASS = "classes=[{name: crane, size_m: [9, 3, 5], max_size_m: [12, 4, 6], labels: [crane]}]"
CAMERA = replace(camera_at("front", (0.0, 0.0, 1.5)), boxes_topic="/front/boxes")


@pytest.mark.parametrize(
    ("settings", "preset", "has_camera", "score"),
    [
        ((), "road", False, "learned"),
        ((), "road", True, "geometric"),
        (("detect2d.method=none",), "road", True, "learned"),
        ((), "sandbox", False, "geometric"),
        (("detect3d.score=learned",), "road", True, "learned"),
        (("detect3d.score=geometric",), "road", False, "geometric"),
        (("detect3d.weights=mine.npz",), "sandbox", True, "learned"),  # an error that names the classes follows
    ],
)
def test_where_the_score_of_clusters_is_learned(
    settings: tuple[str, ...], preset: str, has_camera: bool, score: str
) -> None:
    config = load_config(preset, settings)
    assert decided(config, replace(LIDARS, cameras=(CAMERA,) if has_camera else ())).detect3d.score == score


@pytest.mark.parametrize(
    ("settings", "preset", "method", "model"),
    [
        ((), "road", "combined", EMBEDDED["traffic"]),
        (("detect3d.score=learned",), "road", "cluster", None),
        (("detect3d.method=pillars",), "road", "pillars", EMBEDDED["traffic"]),
        (("detect3d.model=mine.onnx",), "road", "combined", Path("mine.onnx")),
        ((), "sandbox", "combined", EMBEDDED["sandbox"]),
        ((UNKNOWN_CLASS,), "road", "cluster", None),
        (("detect3d.method=none",), "road", "none", None),
    ],
)
def test_what_finds_boxes(settings: tuple[str, ...], preset: str, method: str, model: Path | None) -> None:
    found = decided(load_config(preset, settings), LIDARS).detect3d
    assert (found.method, found.model) == (method, model)


def test_a_network_is_of_no_use_without_cameras() -> None:
    """Cameras without calibration are left out: a 2D network would not enable them."""
    assert boxes_2d_words(load_config("road"), LIDARS) == ("none (no usable camera)", "")
    assert boxes_2d_words(load_config("road"), replace(LIDARS, cameras=(CAMERA,)))[0] == "as recorded"
