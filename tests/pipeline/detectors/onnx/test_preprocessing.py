import numpy as np
import pytest

from lidcam.pipeline.core.settings.detect import NetworkColors
from lidcam.pipeline.detectors.onnx.preprocessing import Placement, Preprocessing

RED_GREEN_BLUE = (30, 20, 10)


@pytest.mark.parametrize(
    ("colors", "pixel", "ground"),
    [
        ("bgr_255", (10, 20, 30), (114, 114, 114)),
        ("rgb_255", (30, 20, 10), (114, 114, 114)),
        ("bgr_1", (10 / 255, 20 / 255, 30 / 255), (114 / 255,) * 3),
        ("rgb_1", (30 / 255, 20 / 255, 10 / 255), (114 / 255,) * 3),
        (
            "imagenet",
            ((30 / 255 - 0.485) / 0.229, (20 / 255 - 0.456) / 0.224, (10 / 255 - 0.406) / 0.225),
            ((114 / 255 - 0.485) / 0.229, (114 / 255 - 0.456) / 0.224, (114 / 255 - 0.406) / 0.225),
        ),
    ],
)
def test_channels(colors: NetworkColors, pixel: tuple[float, ...], ground: tuple[float, ...]) -> None:
    preprocessing = Preprocessing(colors, "top_left")
    batch = preprocessing.blank(2, 4, 8)
    assert batch.shape == (2, 3, 4, 8)
    assert batch.dtype == np.float32
    preprocessing.put(np.full((4, 4, 3), RED_GREEN_BLUE, np.uint8), batch[0])
    np.testing.assert_allclose(batch[0, :, 2, 1], pixel, rtol=1e-6)
    np.testing.assert_allclose(batch[0, :, 2, 5], ground, rtol=1e-6)
    np.testing.assert_allclose(batch[1, :, 2, 1], ground, rtol=1e-6)


@pytest.mark.parametrize(
    ("placement", "columns", "rows"),
    [("top_left", (0, 96), (0, 28)), ("center", (0, 96), (17, 46)), ("stretched", (0, 96), (0, 64))],
)
def test_where_a_wide_image_lies(placement: Placement, columns: tuple[int, int], rows: tuple[int, int]) -> None:
    preprocessing = Preprocessing("rgb_255", placement)
    batch = np.full((1, 3, 64, 96), np.nan, np.float32)
    place = preprocessing.put(np.zeros((375, 1242, 3), np.uint8), batch[0])
    black = batch[0, 0] == 0
    assert (batch[0] == np.where(black, 0.0, 114.0)).all(), "what no image covers is grey"
    assert (np.flatnonzero(black.any(0))[[0, -1]] + [0, 1]).tolist() == [*columns]
    assert (np.flatnonzero(black.any(1))[[0, -1]] + [0, 1]).tolist() == [*rows]
    seen = np.array([[columns[0], rows[0], columns[1], rows[1]]], np.float32)
    np.testing.assert_allclose(place.undo(seen), [[0, 0, 1242, 375]], rtol=1e-5)


@pytest.mark.parametrize("placement", ["top_left", "center", "stretched"])
def test_any_shape_fits(placement: Placement) -> None:
    preprocessing = Preprocessing("rgb_255", placement)
    for height, width in [(1, 1), (1, 900), (900, 1), (64, 96), (65, 97), (63, 95), (2000, 3000)]:
        place = preprocessing.put(np.zeros((height, width, 3), np.uint8), preprocessing.blank(1, 64, 96)[0])
        corners = np.array([0, 0, width, height]) * np.tile(place.scale, 2) + np.tile(place.offset, 2)
        assert (corners[:2] >= 0).all()
        assert (corners[2:] <= [96.001, 64.001]).all()
