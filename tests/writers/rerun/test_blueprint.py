from dataclasses import replace

import pytest
import rerun.blueprint as rrb
from detections import forward_camera
from frames import RIG

from lidcam.pipeline.core.rig import Rig
from lidcam.writers.rerun.blueprint import blueprint, place_eye
from lidcam.writers.viewpoint import SceneSurvey


def rig(*sizes_px: tuple[int, int]) -> Rig:
    cameras = [replace(forward_camera(f"c{row}", size_px=size), topic="/c") for row, size in enumerate(sizes_px)]
    return replace(RIG, cameras=tuple(cameras))


def parts(node: rrb.Container | rrb.View) -> list[str]:
    """The layout from left to right and from top to bottom."""
    name = type(node).__name__
    if isinstance(node, rrb.View):
        return [f"{name} {node.name}"]
    return [name, *(part for child in node.contents for part in parts(child))]


VIEWS = ["Spatial3DView Scene", "Spatial3DView From above"]
CURVES = [f"TimeSeriesView {name}" for name in ("Speeds (m/s)", "Objects")]
PLOTS = ["Tabs", *CURVES, "TextLogView Warnings", "TimeSeriesView Sync skew (ms)", "Spatial2DView Colours"]
IMAGE = "Spatial2DView c0"


@pytest.mark.parametrize(
    ("sizes_px", "expected"),
    [
        ([], ["Tabs", "Horizontal", *VIEWS, "Vertical", "Horizontal", *PLOTS]),
        ([(640, 480)], ["Horizontal", "Vertical", *VIEWS, "Vertical", "Grid", IMAGE, "Horizontal", *PLOTS]),
        ([(1242, 375)], ["Vertical", "Horizontal", "Grid", IMAGE, "Vertical", *PLOTS, "Horizontal", *VIEWS]),
        ([(300, 600)], ["Horizontal", "Tabs", "Vertical", *VIEWS, "Vertical", "Horizontal", *PLOTS, "Grid", IMAGE]),
    ],
)
def test_the_layout_follows_the_images(sizes_px: list[tuple[int, int]], expected: list[str]) -> None:
    survey = SceneSurvey(rig(*sizes_px))
    found = parts(blueprint(survey, place_eye(survey), is_tracked=True).root_container)
    assert found[: len(expected)] == expected
    found = parts(blueprint(survey, place_eye(survey), is_tracked=False).root_container)
    without_speeds = [part for part in expected if part != CURVES[0]]
    assert found[: len(without_speeds)] == without_speeds
