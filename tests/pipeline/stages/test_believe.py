from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d, camera_rig, forward_camera, matches
from fusion_stages import believe_of
from lidar_scene import combined

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.association import class_agreement
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Detect3DConfig
from lidcam.pipeline.fusion.belief.visibility import Visibility, find_visibility

CONFIG = Config()
VIEW = forward_camera()
RIG = camera_rig(VIEW)
CAR = (20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
BESIDE = (20.0, 5.0, 0.0, 4.0, 1.8, 1.5, 0.0)
BEHIND = (-20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
POINTS = combined(np.zeros((0, 3)))
FRAME = SensorBundle(0, 1, 1, {})
GEOMETRIC = Config(detect3d=Detect3DConfig(score="geometric"))
NOTHING = {"cam": boxes2d([])}
SEEN = {"cam": boxes2d([(280, 220, 360, 260, 0.8, 0)])}


def hypotheses(boxes: Boxes3D, *pairs: tuple[int, int], lidar_count: int | None = None) -> Hypotheses:
    projected = VIEW.model.project_boxes(VIEW.T_camera_site.apply(box_corners(boxes.centers, boxes.sizes, boxes.yaws)))
    return Hypotheses(boxes, {"cam": matches(pairs, projected)}, len(boxes) if lidar_count is None else lidar_count)


def believed(found: Hypotheses, seen: Mapping[str, Boxes2D], config: Config = CONFIG) -> F64:
    return believe_of(RIG, config)(found, seen_in(found, seen), FRAME)


def seen_in(found: Hypotheses, seen: Mapping[str, Boxes2D]) -> Visibility:
    return find_visibility(found, seen, {"cam": VIEW}, POINTS, class_agreement(ROAD_CLASSES))


def test_what_a_camera_confirms_what_nobody_looks_at_and_what_it_does_not_confirm() -> None:
    boxes = boxes3d([CAR, BESIDE, BEHIND], scores=[0.2] * 3)
    boxes = replace(boxes, point_counts=np.full(3, 50, np.int32))
    found = hypotheses(boxes, (0, 0))
    confirmed, doubted, unseen = believed(found, SEEN)
    assert confirmed > 0.8
    assert doubted < unseen < confirmed
    without = believed(found, {})
    assert without.tolist() == pytest.approx([unseen] * 3), "a camera without an entry did not look"
    silent = believed(hypotheses(boxes), NOTHING)
    assert silent[1] == pytest.approx(doubted, rel=0.02), "an empty list is a look at nothing"


def test_what_is_too_small_for_a_camera_is_hardly_doubted() -> None:
    boxes = boxes3d([BESIDE, (120.0, 5.0, 0.0, 4.0, 1.8, 1.5, 0.0)], scores=[0.65] * 2)
    near, far = believed(hypotheses(boxes), NOTHING, Config(detect3d=Detect3DConfig(method="combined")))
    assert near < 0.1
    assert far > 0.5


def test_of_vehicles_on_one_ground_one_is_there() -> None:
    rows = [BEHIND, (-21.0, 0.0, 0.0, 8.0, 2.5, 3.0, 0.0), (-23.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)]
    boxes, given = boxes3d(rows, scores=[0.7, 0.8, 0.6]), Config(detect3d=Detect3DConfig(method="none"))
    vehicles, people = (replace(boxes, class_ids=np.array(ids, np.int32)) for ids in ([0, 3, 0], [1, 1, 1]))
    assert believed(hypotheses(vehicles), NOTHING, given).tolist() == pytest.approx([0.2, 0.8, 0.2], rel=0.01)
    assert believed(hypotheses(people), NOTHING, given).tolist() == pytest.approx([0.7, 0.8, 0.6], rel=0.01)


def test_a_blind_camera_takes_less_and_less_away() -> None:
    believe = believe_of(RIG)
    found = hypotheses(boxes3d([CAR], scores=[0.9]))
    (first,) = believe(found, seen_in(found, NOTHING), FRAME)
    for _ in range(100):
        (last,) = believe(found, seen_in(found, NOTHING), FRAME)
    (without,) = believed(found, {})
    assert first < last < without
    assert last > 0.9 * without


@pytest.mark.parametrize(
    ("detector", "is_taken"),
    [(Detect3DConfig(method="none"), True), (Detect3DConfig(score="learned"), True), (GEOMETRIC.detect3d, False)],
)
def test_probabilities_are_taken_as_they_are(detector: Detect3DConfig, is_taken: bool) -> None:
    found = hypotheses(boxes3d([BEHIND], scores=[0.3]))
    (p,) = believed(found, NOTHING, Config(detect3d=detector))
    assert (p == pytest.approx(0.3, abs=1e-3)) == is_taken


def test_what_a_2d_box_proposes_needs_it() -> None:
    boxes = boxes3d([CAR, CAR], scores=[0.5, 0.5])
    found = hypotheses(boxes, (1, 0), lidar_count=0)
    alone, matched = believed(found, SEEN)
    assert alone < 0.3 < matched


def test_no_hypotheses_and_no_cameras() -> None:
    assert believed(hypotheses(boxes3d([])), NOTHING).shape == (0,)
    nobody = Hypotheses(boxes3d([CAR]), {}, 1)
    assert believe_of(camera_rig())(nobody, seen_in(nobody, {}), FRAME).shape == (1,)


def test_what_a_camera_said_counts_while_it_does_not_look_and_never_when_it_does() -> None:
    car = boxes3d([CAR], scores=[0.2])
    (alone,) = believed(hypotheses(car), {})

    def after(
        first: Mapping[str, Boxes2D], *pairs: tuple[int, int], gap_s: float, then: Mapping[str, Boxes2D]
    ) -> float:
        believe = believe_of(RIG)
        for found, seen, at_s in ((hypotheses(car, *pairs), first, 0.0), (hypotheses(car), then, gap_s)):
            beliefs = believe(found, seen_in(found, seen), at(at_s))
        return float(beliefs[0])

    soon, later = (after(SEEN, (0, 0), gap_s=gap_s, then={}) for gap_s in (0.1, 0.5))
    assert alone < later < soon
    assert after(SEEN, (0, 0), gap_s=1.2, then={}) == pytest.approx(alone)
    assert after(NOTHING, gap_s=0.1, then={}) < alone, "what it did not say is remembered, too"
    assert after(SEEN, (0, 0), gap_s=0.1, then=NOTHING) < alone, "silence has the last word"


def test_a_post_that_a_slow_camera_doubts_does_not_come_and_go_with_its_images() -> None:
    believe = believe_of(RIG, Config(detect3d=Detect3DConfig(method="combined")))
    post = hypotheses(boxes3d([(12.0, 0.0, 0.0, 0.7, 0.7, 1.7, 0.0)], scores=[0.93], class_ids=[1]))
    beliefs = [believe(post, seen_in(post, seen), at(0.1 * k))[0] for k, seen in enumerate((NOTHING, {}, NOTHING, {}))]
    assert max(beliefs) < 0.5, beliefs


def test_a_slow_camera_is_not_forgotten_while_another_looks() -> None:
    """One confirms a car in every other frame, the other finds nothing in all."""
    views = {name: replace(VIEW, name=name) for name in ("fast", "slow")}
    believe, car = believe_of(camera_rig(*views.values())), boxes3d([CAR], scores=[0.2])
    beliefs = []
    for frame in range(6):
        looks = frame % 2 == 0
        (one,), (other,) = (hypotheses(car, *pairs).matches.values() for pairs in ([], [(0, 0)] * looks))
        found = Hypotheses(car, {"fast": one, "slow": other}, 1)
        seen = {"fast": NOTHING["cam"], **({"slow": SEEN["cam"]} if looks else {})}
        visibility = find_visibility(found, seen, views, POINTS, class_agreement(ROAD_CLASSES))
        beliefs.append(float(believe(found, visibility, at(0.1 * frame))[0]))
    (without,) = believed(hypotheses(car), NOTHING)
    assert min(beliefs) > (beliefs[0] + without) / 2, beliefs


@pytest.mark.parametrize(("moves", "reaches"), [(True, True), (False, False)])
def test_on_a_rig_that_moves_an_object_is_sought_where_it_is_now(moves: bool, reaches: bool) -> None:
    ahead = (CAR[0] - 10.0, *CAR[1:])
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 10.0 * moves
    motion = PoseSamples("site", "odom", np.array([0, 200_000_000], np.int64), poses)
    believe = believe_of(RIG)
    there = hypotheses(boxes3d([CAR], scores=[0.2]), (0, 0))
    believe(there, seen_in(there, SEEN), at(0.0))
    nearer = hypotheses(boxes3d([ahead], scores=[0.2]))
    (p,) = believe(nearer, seen_in(nearer, {}), replace(at(0.2), motion=motion))
    assert (p > believed(nearer, {})[0]) == reaches


def at(seconds: float) -> SensorBundle:
    stamp_ns = round(seconds * 1e9)
    return SensorBundle(0, stamp_ns, stamp_ns, {})
