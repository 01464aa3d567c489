import numpy as np
import pytest
from detections import boxes2d
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.detectors.riders import finds_riders_apart, join_riders

PEDESTRIAN, BICYCLE = 1, 2
Row = tuple[float, float, float, float, float, int]
BIKE: Row = (100, 100, 200, 160, 0.5, BICYCLE)
RIDER: Row = (130, 50, 170, 150, 0.8, PEDESTRIAN)


def joined(*rows: Row) -> list[Row]:
    boxes = boxes2d(sorted(rows, key=lambda row: -row[4]))
    found = join_riders(boxes, boxes.class_ids == PEDESTRIAN, boxes.class_ids == BICYCLE)
    table = zip(found.xyxy.tolist(), found.scores.tolist(), found.class_ids.tolist(), strict=True)
    return [(*xyxy, round(score, 3), class_id) for xyxy, score, class_id in table]


def moved(row: Row, x: float = 0.0, y: float = 0.0) -> Row:
    return (row[0] + x, row[1] + y, row[2] + x, row[3] + y, *row[4:])


BEHIND, OTHER = moved(RIDER, x=15), moved(BIKE, x=20)
JOINED: Row = (100, 50, 200, 160, 0.8, BICYCLE)
IN_A_ROW = [moved(row, x=60 * i) for i in range(3) for row in (RIDER, BIKE)]


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        pytest.param([RIDER, BIKE], [JOINED], id="one"),
        pytest.param([(*BIKE[:4], 0.9, BICYCLE), RIDER], [(*JOINED[:4], 0.9, BICYCLE)], id="the better score"),
        pytest.param(
            [(100, 40, 140, 130, 0.7, PEDESTRIAN), (110, 90, 130, 150, 0.4, BICYCLE)],
            [(100, 40, 140, 150, 0.7, BICYCLE)],
            id="from behind, where the rider is wider",
        ),
        pytest.param([RIDER, BEHIND, BIKE], [BEHIND, JOINED], id="two people"),
        pytest.param([RIDER, BIKE, OTHER], [JOINED, OTHER], id="two bicycles"),
        pytest.param(IN_A_ROW, [moved(JOINED, x=60 * i) for i in range(3)], id="side by side"),
    ],
)
def test_riders(rows: list[Row], expected: list[Row]) -> None:
    assert joined(*rows) == expected


@pytest.mark.parametrize(
    "rows",
    [
        (),
        (RIDER,),
        (BIKE,),
        (moved(RIDER, x=-80), BIKE),  # beside it
        (moved(RIDER, y=30), BIKE),  # in front of it: the feet are lower
        (moved(RIDER, y=-60), BIKE),  # behind it, far away
        ((130, 95, 170, 150, 0.8, PEDESTRIAN), BIKE),  # no higher than it
        ((130, -150, 170, 150, 0.8, PEDESTRIAN), BIKE),  # too large for it
        (RIDER, (*BIKE[:5], 0)),
    ],
)
def test_no_rider(rows: tuple[Row, ...]) -> None:
    assert joined(*rows) == sorted(rows, key=lambda row: -row[4])


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (("person", "bicycle", "car"), True),
        (("person", "motorcycle"), True),
        (("person", "car"), False),
        (("pedestrian", "bicycle"), False),
        (("person", "rider", "bicycle"), False),
        (("person", "bicycle", "cyclist"), False),
    ],
)
def test_which_networks(labels: tuple[str, ...], expected: bool) -> None:
    assert finds_riders_apart(labels) is expected


sides = st.integers(0, 40)
tables = st.lists(
    st.tuples(
        sides, sides, st.integers(1, 30), st.integers(1, 30), st.sampled_from([0.3, 0.5, 0.9]), st.integers(0, 2)
    ),
    max_size=12,
)


@given(tables)
def test_nothing_is_lost_but_riders(table: list[tuple[int, int, int, int, float, int]]) -> None:
    rows = [(x, y, x + w, y + h, score, class_id) for x, y, w, h, score, class_id in table]
    before = boxes2d(sorted(rows, key=lambda row: -row[4]))
    after = join_riders(before, before.class_ids == PEDESTRIAN, before.class_ids == BICYCLE)
    lost = count(before, PEDESTRIAN) - count(after, PEDESTRIAN)
    assert lost >= 0
    assert count(before, BICYCLE) == count(after, BICYCLE)
    assert count(before, 0) == count(after, 0)
    assert (np.diff(after.scores) <= 0).all()
    unchanged = {tuple(row) for row in before.xyxy.tolist()}
    assert sum(tuple(row) not in unchanged for row in after.xyxy.tolist()) <= lost


def count(boxes: Boxes2D, class_id: int) -> int:
    return int((boxes.class_ids == class_id).sum())
