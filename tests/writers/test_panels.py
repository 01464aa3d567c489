import pytest

from lidcam.writers.panels import arrange


@pytest.mark.parametrize(
    ("count", "aspect", "side", "columns"),
    [
        (1, 4 / 3, "right", 1),
        (1, 3.3, "top", 1),  # KITTI
        (2, 3.3, "right", 1),
        (4, 16 / 9, "right", 2),
        (6, 1.6, "right", 2),
        (8, 4 / 3, "right", 2),
        (1, 0.6, "right", 1),
    ],
)
def test_images_are_as_large_as_they_can_be(count: int, aspect: float, side: str, columns: int) -> None:
    panels = arrange([aspect] * count)
    assert (panels.side, panels.columns) == (side, columns)


@pytest.mark.parametrize("count", range(1, 13))
@pytest.mark.parametrize("aspect", [0.5, 1.0, 4 / 3, 16 / 9, 4.0])
def test_the_scene_keeps_half_of_the_window(count: int, aspect: float) -> None:
    panels = arrange([aspect] * count)
    assert 0 < panels.image_share <= 0.5
    assert 0 <= panels.plot_share < 0.9
    assert 0.5 < panels.scene_aspect < 5
