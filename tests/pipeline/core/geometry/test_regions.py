"""Points in rectangles, against a check of every pair."""

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.regions import points_in_footprints


@given(seed=st.integers(0, 10_000), points=st.integers(0, 300), boxes=st.integers(0, 6))
@settings(derandomize=True)
def test_pairs_are_those_of_shapely(seed: int, points: int, boxes: int) -> None:
    rng = np.random.default_rng(seed)
    xyz, centers = rng.uniform(-6, 6, (points, 3)).astype(np.float32), rng.uniform(-5, 5, (boxes, 2))
    sizes, yaws = rng.uniform(0.2, 6, (boxes, 2)), rng.uniform(-4, 4, boxes)
    rows, box = points_in_footprints(xyz, centers, sizes, yaws)
    flat = box_corners(np.column_stack([centers, np.zeros(boxes)]), np.column_stack([sizes, np.ones(boxes)]), yaws)
    expected = [
        (int(row), number)
        for number, corners in enumerate(flat[:, :4, :2])
        for row in np.flatnonzero(shapely.contains_xy(shapely.Polygon(corners), xyz[:, :2]))
    ]
    assert list(zip(rows.tolist(), box.tolist(), strict=True)) == expected


def test_borders_belong_to_a_rectangle_and_a_point_may_be_in_several() -> None:
    xyz = np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 7.0], [2.0, 1.0, 0.0], [2.1, 0.0, 0.0]], np.float32)
    rows, box = points_in_footprints(xyz, np.zeros((2, 2)), np.array([[4.0, 2.0], [2.0, 4.0]]), np.array([0.0, 0.0]))
    assert rows.tolist() == [0, 1, 2, 1]
    assert box.tolist() == [0, 0, 0, 1]
