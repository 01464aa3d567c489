from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses, Matches
from pipeline.core.settings.config import Config
from pipeline.core.settings.fuse import FuseConfig
from pipeline.stages.fuse import Fuse

CAR, PEDESTRIAN, BICYCLE = 0, 1, 2
PLACE = (5.0, 1.0, 0.5, 4.0, 1.8, 1.5, 0.3)


def matches(*pairs: tuple[int, int], boxes: int) -> Matches:
    return Matches(
        np.array(pairs, np.int64).reshape(-1, 2),
        np.full(len(pairs), 0.8, np.float32),
        np.zeros((boxes, 4), np.float32),
        np.zeros(boxes, np.float32),
    )


def of_lidar(boxes: Boxes3D, found: Mapping[str, Matches]) -> Hypotheses:
    return Hypotheses(boxes, found, len(boxes))


def seen(score: float, class_id: int) -> Boxes2D:
    return boxes2d([(0, 0, 10, 10, score, class_id)])


@pytest.mark.parametrize(
    ("own", "cameras", "class_id", "score"),
    [
        ((0.5, CAR), [], CAR, 0.5),
        ((0.5, CAR), [(0.8, CAR)], CAR, 0.9),
        ((0.5, CAR), [(0.8, PEDESTRIAN)], PEDESTRIAN, 0.9),
        ((0.5, CAR), [(0.8, PEDESTRIAN), (0.5, BICYCLE)], PEDESTRIAN, 0.95),
        ((0.5, CAR), [(0.5, BICYCLE), (0.4, PEDESTRIAN), (0.4, PEDESTRIAN)], PEDESTRIAN, 1 - 0.5 * 0.5 * 0.36),
        ((0.5, CAR), [(0.4, PEDESTRIAN), (0.4, PEDESTRIAN), (0.9, BICYCLE)], BICYCLE, 1 - 0.5 * 0.36 * 0.1),
        ((0.5, PEDESTRIAN), [(0.5, CAR), (0.5, PEDESTRIAN)], PEDESTRIAN, 0.875),
        ((0.5, CAR), [(0.5, BICYCLE), (0.5, PEDESTRIAN)], PEDESTRIAN, 0.875),
        ((0.0, CAR), [(1.0, BICYCLE)], BICYCLE, 1.0),
    ],
    ids=[
        "lidar alone",
        "agreed",
        "class from the camera",
        "the surer camera",
        "two against a surer one",
        "a very sure one against two",
        "a tie goes to the lidar's class",
        "a tie without it goes to the lower id",
        "ends of the scale",
    ],
)
def test_class_and_score(own: tuple[float, int], cameras: list[tuple[float, int]], class_id: int, score: float) -> None:
    lidar = boxes3d([PLACE], scores=[own[0]], class_ids=[own[1]])
    camera_boxes = {f"cam{i}": seen(*camera) for i, camera in enumerate(cameras)}
    fused = Fuse(Config())(of_lidar(lidar, {name: matches((0, 0), boxes=1) for name in camera_boxes}), camera_boxes)
    assert fused.objects.class_ids.tolist() == [class_id]
    assert fused.objects.scores[0] == pytest.approx(score, rel=1e-6)
    assert fused.matched.tolist() == [len(cameras)]
    assert fused.matched.dtype == np.int32


def test_geometry_is_the_lidars() -> None:
    lidar = boxes3d([PLACE, (9, -3, 0.4, 0.6, 0.6, 1.7, -2.0)], scores=[0.5, 0.4], class_ids=[CAR, PEDESTRIAN])
    camera = boxes2d([(0, 0, 9, 9, 0.3, CAR), (5, 5, 9, 9, 0.8, BICYCLE)])
    fused = Fuse(Config())(of_lidar(lidar, {"cam": matches((1, 1), boxes=2)}), {"cam": camera})
    for name in ("centers", "sizes", "yaws", "covariances", "point_counts"):
        np.testing.assert_array_equal(getattr(fused.objects, name), getattr(lidar, name))
    assert (fused.objects.stamp_ns, fused.objects.frame_id) == (lidar.stamp_ns, lidar.frame_id)
    assert fused.objects.class_ids.tolist() == [CAR, BICYCLE]
    assert fused.matched.tolist() == [0, 1]
    assert fused.objects.scores[0] == lidar.scores[0]
    assert lidar.class_ids.tolist() == [CAR, PEDESTRIAN], "the input is left as it was"


def test_no_boxes() -> None:
    fused = Fuse(Config())(of_lidar(boxes3d([]), {"cam": matches(boxes=0)}), {"cam": seen(0.5, CAR)})
    assert len(fused.objects) == len(fused.matched) == 0


def test_min_score_counts_after_the_cameras_have_spoken() -> None:
    lidar = boxes3d([PLACE] * 3, scores=[0.2, 0.2, 0.5])
    fuse = Fuse(Config(fuse=FuseConfig(min_score=0.5)))
    fused = fuse(of_lidar(lidar, {"cam": matches((1, 0), boxes=3)}), {"cam": seen(0.6, CAR)})
    assert fused.objects.point_counts.tolist() == [11, 12]
    assert fused.matched.tolist() == [1, 0]


@given(st.lists(st.tuples(st.floats(0, 1, width=32), st.integers(0, 4)), max_size=6), st.floats(0, 1, width=32))
def test_more_cameras_never_lower_a_score(cameras: list[tuple[float, int]], own: float) -> None:
    lidar, fuse, before = boxes3d([PLACE], scores=[own]), Fuse(Config()), own
    for count in range(1, len(cameras) + 1):
        boxes = {f"cam{i}": seen(*camera) for i, camera in enumerate(cameras[:count])}
        fused = fuse(of_lidar(lidar, {name: matches((0, 0), boxes=1) for name in boxes}), boxes)
        score = float(fused.objects.scores[0])
        assert before - 1e-6 <= score <= 1
        assert score >= max(own, *(s for s, _ in cameras[:count])) - 1e-6
        before = score


def test_what_cameras_look_at_and_do_not_confirm_needs_a_score() -> None:
    lidar = boxes3d([PLACE] * 4, scores=[0.2, 0.2, 0.2, 0.4])
    projected = np.zeros((4, 4), np.float32)
    projected[2] = np.nan  # not in view
    found = replace(matches((1, 0), boxes=4), projected_xyxy=projected)
    fuse = Fuse(Config(fuse=FuseConfig(min_score_unconfirmed=0.3)))
    fused = fuse(of_lidar(lidar, {"cam": found}), {"cam": seen(0.6, CAR)})
    assert fused.objects.point_counts.tolist() == [11, 12, 13]
    assert len(fuse(of_lidar(lidar, {"cam": found}), {}).objects) == 4, (
        "a camera without boxes in this frame does not look"
    )
