"""Objects proposed by 2D boxes, and clusters parted by them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d, camera_rig, matches
from fusion_stages import associate_of, place_of
from lidar_scene import combined, point_cloud, rig, scan
from seen_boxes import Box, camera_at, seen_by, views_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Matches, Source
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.fusion.cameras.sightings import see
from lidcam.pipeline.stages import propose as propose_stage
from lidcam.pipeline.stages.detect3d import Detect3D
from lidcam.pipeline.stages.propose import Propose, Proposed, find_partners

CONFIG = Config()
CAR, PEDESTRIAN, BICYCLE, TRUCK = 0, 1, 2, 3
LIDAR = (0.0, 0.0, 1.8)
CAMERA = camera_at("cam", (0.0, 0.0, 1.6))
CAR_BOX: Box = (16.0, 2.0, 0.775, 4.2, 1.75, 1.55, 0.2)
OTHER: Box = (18.0, -5.0, 0.775, 4.0, 1.7, 1.55, -0.4)


def with_cameras(*cameras: CameraSensor) -> Rig:
    return replace(rig(LIDAR), cameras=cameras)


def cloud_of(*boxes: Box) -> F64:
    points = scan(LIDAR, list(boxes), noise_m=0.01)
    return points[points[:, 2] > 0.2]


def proposed(sensors: Rig, frame: CombinedCloud, lidar: Boxes3D, boxes2d: Mapping[str, Boxes2D]) -> Proposed:
    views = views_of(*sensors.cameras)
    placed, matches = place_of(sensors)(frame, boxes2d, views), associate_of(sensors)(lidar, boxes2d, views)
    classes, settings = CONFIG.classes, CONFIG.detect3d.cluster
    return Propose(sensors, BoxFitter(sensors, classes, settings), settings, classes)(frame, lidar, matches, placed)


def propose(
    points: F64, lidar: Boxes3D | None, boxes2d: Mapping[str, Boxes2D], *cameras: CameraSensor
) -> tuple[Boxes3D, Boxes3D]:
    """The lidar's boxes, by default those that are found in the points; and all hypotheses."""
    sensors, frame = with_cameras(*cameras), combined(points)
    lidar = Detect3D(sensors, CONFIG)(frame) if lidar is None else lidar
    return lidar, proposed(sensors, frame, lidar, boxes2d).boxes


def left_out(boxes: Boxes2D, camera: CameraSensor = CAMERA) -> Mapping[str, int]:
    """What is left out of the 2D boxes of one camera, without points."""
    return proposed(with_cameras(camera), combined(np.zeros((0, 3))), nothing(), {"cam": boxes}).left_out


def nothing() -> Boxes3D:
    return replace(boxes3d([]), stamp_ns=7)


def test_boxes_of_the_lidar_are_all_where_each_2d_box_has_one() -> None:
    lidar, found = propose(
        cloud_of(CAR_BOX, OTHER), None, {"cam": seen_by(CAMERA, [CAR_BOX, OTHER], [CAR, CAR])}, CAMERA
    )
    assert len(lidar) == 2
    assert found is lidar


def test_object_without_a_box_gets_one_from_its_points() -> None:
    boxes = {"cam": seen_by(CAMERA, [CAR_BOX], [CAR])}
    _, found = propose(cloud_of(CAR_BOX, OTHER), nothing(), boxes, CAMERA)
    assert found.sources.tolist() == [Source.BOTH]
    np.testing.assert_allclose(found.centers[0, :2], CAR_BOX[:2], atol=0.3)
    assert abs(found.yaws[0] - CAR_BOX[6]) < 0.1
    assert found.point_counts[0] > 20
    assert found.class_ids.tolist() == [CAR]


def test_object_without_points_stays_where_the_cameras_place_it() -> None:
    boxes = {"cam": seen_by(CAMERA, [CAR_BOX], [CAR])}
    lidar, found = propose(cloud_of(OTHER), None, boxes, CAMERA)
    placed = place_of(camera_rig(CAMERA))(combined(cloud_of(OTHER)), boxes, views_of(CAMERA)).boxes
    assert found.sources.tolist() == [Source.LIDAR, Source.CAMERA]
    np.testing.assert_array_equal(found.centers[: len(lidar)], lidar.centers)
    np.testing.assert_array_equal(found.centers[1], placed.centers[0])


def test_no_object_stands_where_the_lidars_see_bare_ground() -> None:
    x, y = np.meshgrid(np.arange(10, 25, 0.1), np.arange(-10, 10, 0.1))
    ground = np.stack([x, y, 0 * x], 2).reshape(-1, 3)
    below = np.hypot(*(ground[:, :2] - CAR_BOX[:2]).T) < 1.5
    boxes, sensors = {"cam": seen_by(CAMERA, [CAR_BOX, OTHER], [CAR, CAR])}, with_cameras(CAMERA)
    for seen, reasons in ((ground[~below], {propose_stage.BARE: 1}), (ground, {propose_stage.BARE: 2})):
        frame = replace(combined(np.zeros((0, 3))), ground_cloud=point_cloud(seen))
        found = proposed(sensors, frame, nothing(), boxes)
        assert found.left_out == reasons
        assert len(found.boxes) == 2 - reasons[propose_stage.BARE]


def test_2d_boxes_that_propose_no_object_are_counted_by_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    far = (90.0, 2.0, 0.775, 4.2, 1.75, 1.55, 0.2)
    three = seen_by(CAMERA, [CAR_BOX, OTHER, far], [CAR] * 3)
    assert left_out(three) == {propose_stage.TOO_VAGUE: 1}
    outside = three.xyxy + np.array([[0, 0, 0, 0], [2000, 0, 2000, 0], [0, 0, 0, 0]], np.float32)
    assert left_out(replace(three, xyxy=outside)) == {propose_stage.OUT_OF_VIEW: 1, propose_stage.TOO_VAGUE: 1}
    monkeypatch.setattr(propose_stage, "MAX_UNMATCHED", 1)
    assert left_out(replace(three, scores=np.array([0.5, 0.9, 0.4], np.float32))) == {propose_stage.TOO_MANY: 2}
    assert left_out(three.select(np.arange(0))) == {}
    fisheye = replace(CAMERA, model=replace(CAMERA.model.zoomed(0.3), model="equidistant"))
    beside = boxes2d([(200, 300, 400, 450, 0.9, CAR)])
    assert left_out(beside, fisheye) == {propose_stage.OUT_OF_VIEW: 1}, "it reaches from 51 to 93 degrees"


def test_hypotheses_are_the_boxes_of_the_lidar_where_2d_boxes_add_nothing() -> None:
    far = (90.0, 2.0, 0.775, 4.2, 1.75, 1.55, 0.2)
    lidar, found = propose(np.zeros((0, 3)), nothing(), {"cam": seen_by(CAMERA, [far], [CAR])}, CAMERA)
    assert found is lidar, "so that they are not associated again"


def test_one_object_seen_by_two_cameras_is_proposed_once() -> None:
    other = camera_at("other", (0.0, 6.0, 3.0), yaw_deg=-10, pitch_deg=5)
    boxes = {c.name: seen_by(c, [CAR_BOX], [CAR]) for c in (CAMERA, other)}
    for points in (cloud_of(CAR_BOX), np.zeros((0, 3))):
        _, found = propose(points, nothing(), boxes, CAMERA, other)
        assert len(found) == 1


def test_confirmed_box_is_not_replaced_by_what_another_camera_makes_of_it() -> None:
    # The other camera shows only a part of the car, too little for a match.
    other = camera_at("other", (0.0, 6.0, 3.0), yaw_deg=-10, pitch_deg=5)
    part = seen_by(other, [CAR_BOX], [CAR])
    xyxy = part.xyxy.copy()
    xyxy[:, 2] = xyxy[:, 0] + 0.28 * (xyxy[:, 2] - xyxy[:, 0])
    boxes = {"cam": seen_by(CAMERA, [CAR_BOX], [CAR]), "other": replace(part, xyxy=xyxy)}
    lidar, found = propose(cloud_of(CAR_BOX), None, boxes, CAMERA, other)
    assert len(found) == len(lidar) == 1


def test_sure_box_of_the_lidars_is_not_split_by_a_doubtful_2d_box_within_it() -> None:
    lorry = (12.0, 4.0, 1.65, 13.6, 2.5, 3.3, 0.0)
    left, top, right, bottom = seen_by(CAMERA, [lorry], [TRUCK]).xyxy[0].tolist()
    inside = (left, (top + bottom) / 2, (left + right) / 2, bottom)
    boxes = {"cam": boxes2d([(left, top, right, bottom, 0.8, TRUCK), (*inside, 0.2, CAR)], frame_id="cam")}
    lidar = replace(boxes3d([lorry], class_ids=[TRUCK]), stamp_ns=7)
    _, found = propose(cloud_of(lorry), lidar, boxes, CAMERA)
    np.testing.assert_array_equal(found.sizes, lidar.sizes)


def test_cyclist_in_a_cluster_that_is_taken_for_a_car_gets_a_box_of_its_own() -> None:
    cyclist, beside = (12.0, 0.0, 0.85, 1.8, 0.6, 1.7, 1.2), (12.5, 1.2, 0.7, 1.8, 0.6, 1.4, 1.2)
    taken_for = boxes3d([(12.3, 0.6, 0.8, 4.0, 1.7, 1.6, 0.3)], class_ids=[CAR])
    boxes = {"cam": seen_by(CAMERA, [cyclist], [BICYCLE])}
    lidar, found = propose(cloud_of(cyclist, beside), replace(taken_for, stamp_ns=7), boxes, CAMERA)
    assert found.class_ids[len(lidar) :].tolist() == [BICYCLE]
    np.testing.assert_allclose(found.centers[-1, :2], cyclist[:2], atol=0.4)


@pytest.mark.parametrize(("far_m", "count"), [(13.5, 1), (20.0, 2)])
def test_near_person_is_not_the_one_behind(far_m: float, count: int) -> None:
    near, far = ((x_m, 0.3, 0.85, 0.6, 0.6, 1.7, 0.0) for x_m in (13.0, far_m))
    lidar = boxes3d([far], scores=[0.3], class_ids=[PEDESTRIAN])
    _, found = propose(
        cloud_of(near), replace(lidar, stamp_ns=7), {"cam": seen_by(CAMERA, [near], [PEDESTRIAN])}, CAMERA
    )
    assert len(found) == count
    np.testing.assert_allclose(found.centers[-1, 0], (far_m, near[0])[count - 1], atol=0.3)


def test_people_right_behind_another_one_are_no_part_of_them() -> None:
    near, *others = ((x_m, 0.3, 0.85, 0.4, 0.5, 1.7, 0.0) for x_m in (13.0, 13.4, 13.8, 14.2))
    points = np.concatenate([cloud_of(near), *(cloud_of(other) for other in others)])
    _, found = propose(points, nothing(), {"cam": seen_by(CAMERA, [near], [PEDESTRIAN])}, CAMERA)
    assert len(found) == 1
    assert found.class_ids[0] == PEDESTRIAN
    assert found.sizes[0, :2].max() < CONFIG.classes[PEDESTRIAN].max_size_m[0]


def test_car_behind_another_one_is_no_part_of_it() -> None:
    behind = (26.0, 2.6, 0.775, 4.2, 1.75, 1.55, 0.2)
    boxes = {"cam": seen_by(CAMERA, [CAR_BOX, behind], [CAR, CAR])}
    points = cloud_of(CAR_BOX, behind)
    lidar, found = propose(points[points[:, 0] < 20], None, boxes, CAMERA)
    assert len(lidar) == 1
    np.testing.assert_array_equal(found.centers[:1], lidar.centers)
    assert all(np.hypot(*(center[:2] - CAR_BOX[:2])) > 5 for center in found.centers[1:])


@pytest.mark.parametrize("with_boxes", [False, True])
def test_no_cameras_no_points_no_lidars(with_boxes: bool) -> None:
    _, found = propose(np.zeros((0, 3)), nothing(), {})
    assert len(found) == 0
    boxes = {"cam": seen_by(CAMERA, [CAR_BOX], [CAR])} if with_boxes else {}
    _, found = propose(np.zeros((0, 3)), nothing(), boxes, CAMERA)
    assert found.sources.tolist() == [Source.CAMERA] * with_boxes
    found = proposed(camera_rig(CAMERA), combined(np.zeros((0, 3))), nothing(), boxes).boxes
    assert found.sources.tolist() == [Source.CAMERA] * with_boxes


VIEWS = views_of(camera_at("a", (0.0, 0.0, 2.0)), camera_at("b", (0.0, 0.0, 2.0)))
LOW, HIGH = (100.0, 100, 200, 200, 0.3, 0), (300.0, 100, 400, 200, 0.9, 0)


def matched(*pairs: tuple[int, int, float]) -> Matches:
    table = np.array(pairs, np.float64).reshape(-1, 3)
    return matches(table[:, :2], np.full((9, 4), np.nan), overlaps=table[:, 2].tolist())


def test_rows_are_those_of_the_2d_boxes_however_they_are_ordered() -> None:
    sightings = see(VIEWS, {"a": boxes2d([LOW, HIGH]), "b": boxes2d([HIGH])})
    partner = find_partners(sightings, {"a": matched((7, 0, 0.5)), "b": matched((2, 0, 0.75))}, ("a", "b"))
    assert sightings.rows.tolist() == [1, 0, 0]
    assert partner.tolist() == [-1, 7, 2]


def test_camera_without_boxes_or_matches() -> None:
    sightings = see(VIEWS, {"b": boxes2d([LOW])})
    partner = find_partners(sightings, {"a": matched(), "b": matched()}, ("a", "b"))
    assert partner.tolist() == [-1]
