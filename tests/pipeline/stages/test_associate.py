from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, boxes3d, camera_rig, forward_camera
from fusion_stages import associate_of
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Matches
from lidcam.pipeline.core.rig import Rig

Row = tuple[float, ...]

CAR, PEDESTRIAN, TRUCK = 0, 1, 3


def associate(boxes: Boxes3D, found: Mapping[str, Boxes2D], *, rig: Rig | None = None) -> Mapping[str, Matches]:
    rig = rig or camera_rig(forward_camera())
    return associate_of(rig)(boxes, found, {camera.name: camera for camera in rig.cameras})


def match(boxes: Boxes3D, rows: Sequence[Row]) -> list[tuple[int, int]]:
    pairs = associate(boxes, {"cam": boxes2d(rows)})["cam"].pairs
    return [(int(a), int(b)) for a, b in pairs]


def projection(boxes: Boxes3D) -> Array:
    """Where each 3D box appears, clipped to the image."""
    return associate(boxes, {"cam": boxes2d([])})["cam"].projected_xyxy


def shown(xyxy: Sequence[float] | Array, *, score: float = 0.8, class_id: int = CAR, shift: float = 0.0) -> Row:
    """A 2D box at a place, `shift` times its width to the right."""
    left, top, right, bottom = (float(v) for v in xyxy)
    dx = shift * (right - left)
    return (left + dx, top, right + dx, bottom, score, class_id)


AHEAD = (10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0)
LEFT = (10.0, 4.0, 0.0, 4.0, 2.0, 1.5, 0.0)
BEHIND = (-10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0)
PASSING = boxes3d([(2.2, 3.3, -0.85, 4.0, 1.7, 1.5, 0.0)])  # its front is in view, its rear 20 cm ahead of the camera
TWO = boxes3d([AHEAD, LEFT])
AT = projection(TWO)


@pytest.mark.parametrize(
    ("boxes", "rows", "expected"),
    [
        pytest.param(boxes3d([]), [], [], id="nothing"),
        pytest.param(boxes3d([]), [shown(AT[0])], [], id="no 3D boxes"),
        pytest.param(TWO, [], [], id="no 2D boxes"),
        pytest.param(TWO, [shown(AT[1]), shown(AT[0])], [(0, 1), (1, 0)], id="each to its own"),
        pytest.param(TWO, [shown(AT[1])], [(1, 0)], id="one is missed"),
        pytest.param(TWO, [shown(AT[0]), shown(AT[0], shift=0.1)], [(0, 0)], id="the better of two 2D boxes"),
        pytest.param(boxes3d([AHEAD, (10.2, *AHEAD[1:])]), [shown(AT[0])], [(0, 0)], id="the better of two 3D boxes"),
        pytest.param(PASSING, [shown(projection(PASSING)[0])], [(0, 0)], id="beside the camera"),
        pytest.param(boxes3d([BEHIND, AHEAD]), [shown(AT[0])], [(1, 0)], id="behind the camera"),
    ],
)
def test_standing_cases(boxes: Boxes3D, rows: list[Row], expected: list[tuple[int, int]]) -> None:
    assert match(boxes, rows) == expected


def test_what_lies_elsewhere_is_no_partner() -> None:
    far = shown(AT[0], shift=2.0)
    assert match(boxes3d([AHEAD]), [far]) == []
    assert match(boxes3d([AHEAD]), [far, shown(AT[0])]) == [(0, 1)]


def test_a_near_miss_is_a_partner(monkeypatch: pytest.MonkeyPatch) -> None:
    small = boxes3d([(30.0, 0.0, 0.0, 0.6, 0.6, 1.7, 0.0)], class_ids=[PEDESTRIAN])
    beside = [shown(projection(small)[0], shift=1.2, class_id=PEDESTRIAN)]
    assert match(small, beside) == [(0, 0)]
    monkeypatch.setattr("lidcam.pipeline.stages.associate.MAX_SIGMAS", 3.0)
    assert match(small, beside) == [(0, 0)]
    monkeypatch.setattr("lidcam.pipeline.stages.associate.CALIBRATION_SIGMA_RAD", 0.0)
    assert match(small, beside) == []


def test_no_pair_takes_a_box_from_a_better_sum() -> None:
    # Taking the best pair first leaves the other box without any.
    boxes = boxes3d([AHEAD, (*AHEAD[:1], -0.45, *AHEAD[2:])])
    first, second = projection(boxes)
    width = first[2] - first[0]
    lag = (second[0] - first[0]) / width
    rows = [shown(first, shift=0.45 * lag), shown(first, shift=-0.3)]
    assert match(boxes, rows) == [(0, 1), (1, 0)]


def test_boxes_beyond_the_border_are_compared_inside_the_image() -> None:
    near = boxes3d([(4.0, 2.6, 0.0, 3.0, 1.8, 1.5, 0.0)])
    left, top, right, bottom = (float(v) for v in projection(near)[0])
    assert left == 0
    found = associate(near, {"cam": boxes2d([(left - 300, top, right, bottom, 0.9, CAR)])})["cam"]
    assert found.iou.tolist() == [1.0]


def test_the_better_class_wins_among_boxes_that_fit_alike() -> None:
    rows = [shown(AT[0], class_id=PEDESTRIAN), shown(AT[0], shift=0.02)]
    assert match(boxes3d([AHEAD]), rows) == [(0, 1)]
    assert match(boxes3d([AHEAD]), rows[:1]) == [(0, 0)], "detectors err"
    rows = [shown(AT[0], class_id=TRUCK), shown(AT[0], class_id=PEDESTRIAN, score=0.9)]
    assert match(boxes3d([AHEAD]), rows) == [(0, 0)], "classes of like size are confused"
    rows = [shown(AT[0], score=0.3), shown(AT[0], shift=0.01, score=0.9)]
    assert match(boxes3d([AHEAD]), rows) == [(0, 1)], "the surer of two like boxes"


def test_each_camera_confirms_on_its_own() -> None:
    # The predecessor system gave a vehicle to the first camera that reached the threshold, though the second one saw it
    # better (first_camera_not_best), and let a vehicle that was matched already use up the boxes of its other cameras
    # (second_camera_consumes).
    rig = camera_rig(forward_camera("a"), forward_camera("b"))
    boxes = boxes3d([AHEAD, (10.0, -0.8, 0.0, 4.0, 2.0, 1.5, 0.0)])
    first, second = projection(boxes)
    seen = {"b": boxes2d([shown(second, shift=-0.02), shown(first)]), "a": boxes2d([shown(first, shift=-0.3)])}
    found = associate(boxes, seen, rig=rig)
    assert [*found] == ["a", "b"], "in the order of the rig"
    assert found["a"].pairs.tolist() == [[0, 0]]
    assert found["b"].pairs.tolist() == [[0, 1], [1, 0]]
    alone = associate(boxes, {"a": boxes2d([shown(first)]), "b": boxes2d([shown(second)])}, rig=rig)
    assert [alone[name].pairs.tolist() for name in "ab"] == [[[0, 0]], [[1, 0]]]


spots = st.tuples(st.integers(0, 4), st.integers(0, 1))
rows_3d = st.lists(st.tuples(spots, st.sampled_from([0.3, 0.6])), max_size=5)
rows_2d = st.lists(st.tuples(spots, st.sampled_from([-0.2, 0.0, 0.1]), st.sampled_from([0.4, 0.9])), max_size=5)


def scene(rows3: Sequence[Any], rows2: Sequence[Any]) -> tuple[Boxes3D, Boxes2D]:
    """Boxes in crowded places, so that ties and rivals are common."""
    places = [(10.0, 1.0 - 0.5 * spot, 0.0, 4.0, 2.0, 1.5, 0.0) for (spot, _), *_ in rows3]
    boxes = boxes3d(places, scores=[score for _, score in rows3], class_ids=[c for (_, c), _ in rows3])
    targets = projection(boxes3d([(10.0, 1.0 - 0.5 * spot, 0.0, 4.0, 2.0, 1.5, 0.0) for (spot, _), *_ in rows2]))
    seen = [
        shown(xyxy, score=score, class_id=c, shift=shift)
        for xyxy, ((_, c), shift, score) in zip(targets, rows2, strict=True)
    ]
    return boxes, boxes2d(seen)


@given(rows_3d, rows_2d, st.randoms(use_true_random=False))
def test_order_of_boxes_does_not_matter(rows3: list[Any], rows2: list[Any], random: Any) -> None:
    boxes, seen = scene(rows3, rows2)
    order3 = np.array(random.sample(range(len(boxes)), len(boxes)), np.intp)
    order2 = np.array(random.sample(range(len(seen)), len(seen)), np.intp)
    straight = associate(boxes, {"cam": seen})["cam"]
    mixed = associate(boxes.select(order3), {"cam": seen.select(order2)})["cam"]

    def named(found: Matches, three: Sequence[Any], two: Sequence[Any]) -> list[Any]:  # equal rows are one and the same
        return sorted((three[i], two[j], float(v)) for (i, j), v in zip(found.pairs, found.iou, strict=True))

    assert named(straight, rows3, rows2) == named(mixed, [rows3[i] for i in order3], [rows2[i] for i in order2])
