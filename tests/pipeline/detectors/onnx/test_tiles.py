from pathlib import Path

import numpy as np
import pytest
from helpers import at_most
from hypothesis import given
from hypothesis import strategies as st
from onnx_files import write_yolox

from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.tiles import Tile, join_tiles, tiles_of
from lidcam.pipeline.detectors.protocols import Candidates2D

Row = tuple[float, float, float, float, float, int]
LEFT, RIGHT = Tile(0, 0, 120, 50), Tile(80, 0, 200, 50)


@pytest.mark.parametrize(
    ("image", "input_px", "max_px", "count"),
    [
        ((375, 1242), (416, 416), 640 * 480, 2),
        ((375, 1242), (416, 416), 40 * 416**2, 4),
        ((100, 331), (416, 416), 40 * 416**2, 1),
        ((375, 1242), (640, 640), 640 * 960, 2),
        ((480, 640), (480, 640), 10 * 640 * 480, 1),
        ((1242, 375), (416, 416), 640 * 480, 2),
        ((1, 1), (416, 416), 640 * 480, 1),
        ((1000, 5000), (416, 416), 10 * 416**2, 5),
    ],
)
def test_how_many(image: tuple[int, int], input_px: tuple[int, int], max_px: int, count: int) -> None:
    assert len(tiles_of(*image, input_px, max_px)) == count


@given(st.integers(1, 3000), st.integers(1, 3000), st.sampled_from([(416, 416), (320, 640)]), st.integers(1, 10**7))
def test_tiles_cover_the_image_and_overlap(height: int, width: int, input_px: tuple[int, int], max_px: int) -> None:
    tiles = tiles_of(height, width, input_px, max_px)
    seen = np.zeros((height, width), np.uint8)
    for tile in tiles:
        assert 0 <= tile.left < tile.right <= width
        assert 0 <= tile.top < tile.bottom <= height
        seen[tile.top : tile.bottom, tile.left : tile.right] += 1
    assert seen.all()
    if len(tiles) > 1:
        sides = {(tile.right - tile.left, tile.bottom - tile.top) for tile in tiles}
        assert len(sides) == 1
        assert len(tiles) <= round(max_px / (input_px[0] * input_px[1]))


def candidates(*rows: Row) -> Candidates2D:
    table = np.array(rows, np.float32).reshape(-1, 6)
    return Candidates2D(table[:, :4], table[:, 4], table[:, 5].astype(np.int64))


def joined(left: list[Row], right: list[Row]) -> list[Row]:
    """What is found in two tiles, each in pixels of the image."""
    shifted = [(x0 - 80, y0, x1 - 80, y1, score, label) for x0, y0, x1, y1, score, label in right]
    found = join_tiles([candidates(*left), candidates(*shifted)], [LEFT, RIGHT], min_score=0.3)
    return [
        (*xyxy, round(score, 3), label)
        for xyxy, score, label in zip(found.xyxy.tolist(), found.scores.tolist(), found.labels.tolist(), strict=True)
    ]


WHOLE: Row = (90, 10, 160, 40, 0.9, 0)
PART: Row = (91, 10, 120, 40, 0.6, 0)
WIDE: Row = (40, 10, 120, 40, 0.6, 0)
SURE: Row = (90, 10, 110, 40, 0.3, 0)


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        pytest.param([], [], [], id="none"),
        pytest.param([(10, 10, 40, 40, 0.9, 0)], [WHOLE], [(10, 10, 40, 40, 0.9, 0), WHOLE], id="one in each"),
        pytest.param([PART], [WHOLE], [WHOLE], id="cut at a seam"),
        pytest.param([PART], [], [PART], id="cut, and not seen in the other tile"),
        pytest.param([(91, 10, 120, 40, 0.6, 1)], [WHOLE], [(91, 10, 120, 40, 0.6, 1), WHOLE], id="another class"),
        pytest.param([PART, WHOLE], [], [PART, WHOLE], id="of the same tile"),
        pytest.param([(91, 10, 110, 40, 0.6, 0)], [WHOLE], [(91, 10, 110, 40, 0.6, 0), WHOLE], id="not at the seam"),
        pytest.param([WIDE], [(80, 10, 150, 40, 0.6, 0)], [WIDE, (80, 10, 150, 40, 0.6, 0)], id="too wide for either"),
        pytest.param([(90, 10, 110, 40, 0.29, 0)], [SURE], [SURE], id="below the least score"),
    ],
)
def test_what_tiles_show(left: list[Row], right: list[Row], expected: list[Row]) -> None:
    assert joined(left, right) == expected


def test_boxes_that_are_no_boxes_stay_as_they_are() -> None:
    rows: list[Row] = [(np.nan, 0, 120, 40, 0.9, 0), (50, 10, 40, 40, 0.9, 0), (0, 0, np.inf, 40, 0.9, 0)]
    expected = np.array([row[:4] for row in (*rows, *rows)])
    expected[3:, ::2] += RIGHT.left
    found = join_tiles([candidates(*rows), candidates(*rows)], [LEFT, RIGHT], min_score=0.3)
    np.testing.assert_array_equal(found.xyxy, expected)


def test_only_boxes_at_a_seam_are_compared() -> None:
    """All boxes of all cells, as `detect2d.min_score: 0` keeps them, would take gigabytes."""
    many = [(10.0, 10.0, 40.0, 40.0, 0.9, 0)] * 3000
    with at_most(50):
        found = join_tiles([candidates(*many, PART), candidates(*many)], [LEFT, RIGHT], min_score=0.0)
    assert len(found.scores) == 6000


def test_a_network_of_one_size_sees_a_wide_image_in_tiles(tmp_path: Path) -> None:
    rows = np.zeros((84, 85), np.float32)
    rows[0] = [40, 32, 20, 20, 1, 0, 0, 0.5, *[0] * 77]  # just right of the middle of a tile
    model = OnnxDetector2D(write_yolox(tmp_path / "m.onnx", rows, size_px=(64, 64)), Detect2DConfig())
    (found,) = model([np.zeros((64, 180, 3), np.uint8)])
    assert found.scores.tolist() == [0.5, 0.5, 0.5]
    centers = (found.xyxy[:, :2] + found.xyxy[:, 2:]) / 2
    tiles = tiles_of(64, 180, (64, 64), 640 * 480)
    assert [(tile.left, tile.right) for tile in tiles] == [(0, 70), (55, 125), (110, 180)]
    np.testing.assert_allclose(centers, [[43.75, 35], [98.75, 35], [153.75, 35]], atol=0.6)
