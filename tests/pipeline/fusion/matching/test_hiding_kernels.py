"""What is covered, against the same in array arithmetic: all pairs at once, as a table."""

from itertools import pairwise, product

import numpy as np
from detections import boxes3d, forward_camera
from hypothesis import given, settings
from hypothesis import strategies as st
from pipeline.fusion.matching.hiding import MAX_COVERS, hidden_parts

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import box_corners
from pipeline.fusion.matching.in_view import InView, project_into_views
from pipeline.fusion.projection import CameraArrays

CAMERAS = (forward_camera(),)
spots = st.tuples(
    st.floats(6, 25), st.floats(-4, 4), st.just(0.0),
    st.floats(0.5, 9), st.floats(0.5, 2), st.floats(0.5, 2), st.floats(-3, 3),
)  # fmt: skip


def sides(boxes: Boxes3D, own: int, other: int) -> tuple[bool, bool]:
    """Whether a side of a box parts it from another with the camera, at the origin, on its own side; on the other's."""
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)[other, :4, :2]
    cos, sin = np.cos(boxes.yaws[own]), np.sin(boxes.yaws[own])
    x, y = (np.concatenate([corners, [[0.0, 0.0]]]) - boxes.centers[own, :2]).T
    along, across = x * cos + y * sin, y * cos - x * sin
    half = boxes.sizes[own, :2] / 2
    reach = np.stack([along - half[0], -along - half[0], across - half[1], -across - half[1]])
    parted, beyond = (reach[:, :4] >= 0).all(1), reach[:, 4] >= 0
    return bool((parted & ~beyond).any()), bool((parted & beyond).any())


def is_nearer(boxes: Boxes3D, seen: InView, front: int, back: int) -> bool:
    rows = int(seen.rows[front]), int(seen.rows[back])
    own, other = sides(boxes, *rows), sides(boxes, *rows[::-1])
    is_front, is_back = own[0] or other[1], other[0] or own[1]
    return bool(seen.ranges_m[front] < seen.ranges_m[back]) if is_front == is_back else is_front


def expected(boxes: Boxes3D, seen: InView, back: int) -> tuple[float, F64]:
    own, covers = seen.xyxy[back].astype(np.float64), []
    for front in range(len(seen)):
        (left, top, right, bottom), other = own.tolist(), seen.xyxy[front].tolist()
        left, top, right, bottom = max(left, other[0]), max(top, other[1]), min(right, other[2]), min(bottom, other[3])
        if front != back and right > left and bottom > top and is_nearer(boxes, seen, front, back):
            covers.append((left, top, right, bottom))
    covers = sorted(covers, key=lambda c: -(c[2] - c[0]) * (c[3] - c[1]))[:MAX_COVERS]
    xs, ys = (sorted({*own[axis::2], *(c[axis] for c in covers), *(c[axis + 2] for c in covers)}) for axis in (0, 1))
    free = [
        (x, y, right, bottom)
        for (x, right), (y, bottom) in product(pairwise(xs), pairwise(ys))
        if not any(c[0] <= x and right <= c[2] and c[1] <= y and bottom <= c[3] for c in covers)
    ]
    if not free:
        return 1.0, own
    table = np.array(free)
    left_to_see = ((table[:, 2] - table[:, 0]) * (table[:, 3] - table[:, 1])).sum()
    share = 1 - left_to_see / ((own[2] - own[0]) * (own[3] - own[1]))
    return share, np.concatenate([table[:, :2].min(0), table[:, 2:].max(0)])


@settings(max_examples=30)
@given(st.lists(spots, max_size=12))
def test_parts_are_those_of_each_box_by_itself(table: list[tuple[float, ...]]) -> None:
    boxes = boxes3d(table)
    seen = project_into_views(boxes, CAMERAS, CameraArrays.of(CAMERAS))
    shares, rest = hidden_parts(boxes, seen, np.zeros((1, 3)))
    for back in range(len(seen)):
        share, rectangle = expected(boxes, seen, back)
        np.testing.assert_allclose(shares[back], share, atol=1e-6)
        np.testing.assert_allclose(rest[back], rectangle, rtol=1e-6)
