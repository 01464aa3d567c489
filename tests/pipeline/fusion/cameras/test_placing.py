"""Placing one 2D box: against the 3D box that it was projected from."""

from collections.abc import Sequence

import numpy as np
import pytest
from detections import boxes2d
from hypothesis import given
from hypothesis import strategies as st
from seen_boxes import Box, camera_at, seen_by, views_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.fusion.cameras.merging import Moments, moments
from lidcam.pipeline.fusion.cameras.placing import SizePriors, place
from lidcam.pipeline.fusion.cameras.sightings import Noise, see

PRIORS = SizePriors.of(ROAD_CLASSES)
NOISE = Noise(1.5, 0.03, 0.05, 0.008, 0.002)
CAR, PEDESTRIAN, TRUCK = 0, 1, 3
LOW = camera_at("low", (0.0, 0.0, 1.6))
MAST = camera_at("mast", (0.0, 0.0, 6.0), pitch_deg=15)


def flat(xy: F64, height_m: float = 0.0) -> F64:
    """Level ground."""
    return np.full(xy.shape[:-1], height_m)


def placed(camera: CameraSensor, rows: Sequence[Sequence[float]]) -> Moments:
    sightings = see(views_of(camera), {camera.name: boxes2d(rows)})
    return moments(place(sightings, PRIORS, flat, NOISE), sightings.origin[:, :2])


def standing(class_id: int, x: float, y: float, yaw: float) -> Box:
    length, width, height = ROAD_CLASSES[class_id].size_m
    return x, y, height / 2, length, width, height, yaw


def of_box(camera: CameraSensor, box: Box, class_id: int) -> Moments:
    boxes = seen_by(camera, [box], [class_id])
    return placed(camera, np.column_stack([boxes.xyxy, boxes.scores, boxes.class_ids]).tolist())


def squared_distance(found: Moments, box: Box) -> float:
    gap = found.xy[0] - box[:2]
    return float(gap @ np.linalg.solve(found.covariances[0, :2, :2], gap))


@pytest.mark.parametrize("camera", [LOW, MAST])
@given(
    class_id=st.sampled_from([CAR, PEDESTRIAN, TRUCK]),
    x=st.floats(22, 60),
    share=st.floats(-0.3, 0.3),
    yaw=st.floats(-1.5, 1.5),
)
def test_object_of_the_classs_size_is_within_its_covariance(
    camera: CameraSensor, class_id: int, x: float, share: float, yaw: float
) -> None:
    box = standing(class_id, x, share * x, yaw)
    found = of_box(camera, box, class_id)
    assert squared_distance(found, box) < 9.2  # 1 % of normal errors are larger
    assert np.hypot(*(found.xy[0] - box[:2])) < 0.15 * x


def test_covariance_lies_along_the_ray_and_grows_with_range() -> None:
    near, far = (of_box(LOW, standing(CAR, x, 0.0, 0.0), CAR).covariances[0] for x in (12.0, 48.0))
    assert far[0, 0] > 4 * near[0, 0]
    assert far[0, 0] > 10 * far[1, 1]


def test_ground_tells_the_range_of_what_is_smaller_than_its_class() -> None:
    child = (10.0, 0.0, 0.55, 0.4, 0.4, 1.1, 0.0)
    found = of_box(MAST, child, PEDESTRIAN)
    assert found.xy[0, 0] == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize(("yaw", "tolerance_deg"), [(0.0, 15), (np.pi / 2, 15)])
def test_width_tells_along_from_across(yaw: float, tolerance_deg: float) -> None:
    found = of_box(LOW, standing(CAR, 25.0, 0.0, yaw), CAR)
    off = (found.yaw_rad[0] - yaw + np.pi / 2) % np.pi - np.pi / 2
    assert abs(np.degrees(off)) < tolerance_deg
    assert np.sqrt(found.covariances[0, 2, 2]) > np.radians(4)


def test_cut_box_is_placed_by_what_is_left_of_it() -> None:
    box = standing(CAR, 12.0, 7.4, 0.0)
    found = of_box(LOW, box, CAR)
    boxes = seen_by(LOW, [box], [CAR])
    assert boxes.xyxy[0, 0] == 0
    assert squared_distance(found, box) < 9.2
    assert np.hypot(*(found.xy[0] - box[:2])) < 2.0


def test_box_cut_on_all_sides_says_little_and_stays_finite() -> None:
    found = placed(LOW, [(0, 0, 1280, 720, 0.9, CAR), (0, 700, 30, 720, 0.9, CAR), (600, 0, 640, 9, 0.5, PEDESTRIAN)])
    assert np.isfinite(found.xy).all()
    assert np.isfinite(found.covariances).all()
    assert np.sqrt(found.covariances[:2, 0, 0]).min() > 1.0


def test_box_behind_a_nearer_one_is_less_certain() -> None:
    behind, front = (600.0, 330, 660, 400, 0.8, CAR), (560.0, 340, 760, 460, 0.9, CAR)
    alone, both = placed(LOW, [behind]), placed(LOW, [front, behind])
    assert both.covariances[1, 0, 0] > 1.5 * alone.covariances[0, 0, 0]


@given(st.lists(st.tuples(*[st.floats(0, 1280)] * 2, *[st.floats(0, 720)] * 2), min_size=1, max_size=4))
def test_any_box_has_a_finite_place_and_a_sound_covariance(corners: list[tuple[float, ...]]) -> None:
    rows = [(min(a, b), min(c, d), max(a, b), max(c, d), 0.5, CAR) for a, b, c, d in corners]
    found = placed(MAST, rows)
    assert np.isfinite(found.xy).all()
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()
