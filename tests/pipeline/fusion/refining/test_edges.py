import numpy as np
import pytest

from lidcam.pipeline.fusion.refining.edges import are_crowded

BOX = [100, 50, 180, 100]


@pytest.mark.parametrize(
    ("other", "crowded"),
    [
        ([60, 52, 120, 98], "left"),
        ([160, 40, 240, 110], "right"),
        ([110, 20, 170, 60], "top"),
        ([110, 90, 170, 130], "bottom"),
        ([90, 40, 200, 120], "left top right bottom"),
        ([120, 60, 160, 90], ""),
        ([20, 50, 100, 100], ""),
        ([60, 52, 120, 65], ""),
        ([200, 50, 260, 100], ""),
        (BOX, ""),
    ],
    ids=["left", "right", "top", "bottom", "around", "inside", "beside", "corner", "away", "same"],
)
def test_edges_in_another_box(other: list[float], crowded: str) -> None:
    found = are_crowded(np.array([BOX, other, [500, 300, 520, 310]], np.float32))
    assert " ".join(np.array(["left", "top", "right", "bottom"])[found[0]]) == crowded
    assert not found[2].any()


def test_none_and_one() -> None:
    assert are_crowded(np.zeros((0, 4), np.float32)).shape == (0, 4)
    assert not are_crowded(np.array([BOX], np.float32)).any()
