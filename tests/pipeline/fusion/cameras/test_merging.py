from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seen_boxes import camera_at, seen_by, views_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.fusion.cameras.merging import Moments, mean_places, merge_sightings, moments
from lidcam.pipeline.fusion.cameras.placing import HEADINGS, Placements, SizePriors, place
from lidcam.pipeline.fusion.cameras.sightings import Noise, Sightings, see

CAR, PEDESTRIAN = 0, 1
NORTH = camera_at("north", (0.0, 20.0, 5.0), yaw_deg=-90, pitch_deg=10)
WEST = camera_at("west", (-20.0, 0.0, 5.0), pitch_deg=10)
VIEW = np.zeros((1, 2))
EAST = camera_at("east", (20.0, 0.0, 5.0), yaw_deg=180, pitch_deg=10)


def normal(xy: F64, std_m: float) -> Placements:
    """Round distributions about places (P, 2), all headings alike."""
    places = np.repeat(np.asarray(xy, float)[:, None], len(HEADINGS), 1)
    covariances = np.broadcast_to(std_m**2 * np.eye(2), (*places.shape, 2))
    return Placements(places, covariances.copy(), np.zeros(places.shape[:2]))


def placed(sightings: Sightings) -> Placements:
    """On level ground."""
    noise = Noise(1.5, 0.03, 0.05, 0.008, 0.002)
    return place(sightings, SizePriors.of(ROAD_CLASSES), lambda xy: np.zeros(xy.shape[:-1]), noise)


def merged(cars: list[tuple[float, float, float]], *cameras: CameraSensor) -> tuple[list[int], Moments]:
    """Objects of the sightings of cars at x, y, yaw."""
    length, width, height = ROAD_CLASSES[CAR].size_m
    boxes = [(x, y, height / 2, length, width, height, yaw) for x, y, yaw in cars]
    found = {camera.name: seen_by(camera, boxes, [CAR] * len(boxes)) for camera in cameras}
    sightings = see(views_of(*cameras), found)
    objects, known = merge_sightings(placed(sightings), sightings.cameras, sightings.class_ids)
    return objects.tolist(), moments(known, np.zeros((len(known.xy), 2)))


def test_cameras_from_two_sides_place_and_turn_an_object_better_than_each() -> None:
    one, two = merged([(2.0, 3.0, 0.5)], WEST), merged([(2.0, 3.0, 0.5)], WEST, NORTH)
    assert two[0] == [0, 0]
    assert np.trace(two[1].covariances[0, :2, :2]) < 0.2 * np.trace(one[1].covariances[0, :2, :2])
    np.testing.assert_allclose(two[1].xy, [[2.0, 3.0]], atol=0.3)
    assert abs(two[1].yaw_rad[0] - 0.5) < np.radians(20)


def test_each_object_has_one_sighting_of_each_camera() -> None:
    cars = [(-3.0, 5.0, 0.0), (4.0, -2.0, 1.0), (4.0, 6.0, 0.0)]
    objects, found = merged(cars, WEST, NORTH, EAST)
    assert sorted(objects) == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    gap = np.abs(found.xy[:, None] - np.array(cars)[:, :2]).max(-1)
    assert sorted(gap.argmin(1).tolist()) == [0, 1, 2]
    assert gap.min(1).max() < 0.5


def test_information_of_independent_sightings_adds_up() -> None:
    placements = normal(np.array([[0.0, 0.0], [1.0, 0.0]]), 2.0)
    objects, known = merge_sightings(placements, np.array([0, 1]), np.array([CAR, CAR]))
    found = moments(known, VIEW)
    assert objects.tolist() == [0, 0]
    np.testing.assert_allclose(found.xy, [[0.5, 0.0]])
    np.testing.assert_allclose(found.covariances[0, :2, :2], 2.0 * np.eye(2), atol=1e-12)


def test_far_ones_other_classes_and_the_same_camera_are_apart() -> None:
    for xy, cameras, classes in (
        ([[0.0, 0.0], [9.0, 0.0]], [0, 1], [CAR, CAR]),
        ([[0.0, 0.0], [0.1, 0.0]], [0, 1], [CAR, PEDESTRIAN]),
        ([[0.0, 0.0], [0.1, 0.0]], [0, 0], [CAR, CAR]),
    ):
        objects, known = merge_sightings(normal(np.array(xy), 1.0), np.array(cameras), np.array(classes))
        assert objects.tolist() == [0, 1]
        np.testing.assert_allclose(mean_places(known)[0], xy)


def test_heading_of_nothing_known_is_uncertain_to_the_limit() -> None:
    found = moments(normal(np.zeros((1, 2)), 1.0), VIEW)
    assert np.sqrt(found.covariances[0, 2, 2]) > np.radians(50)
    assert np.isclose(moments(sure_of(11), VIEW).yaw_rad[0], HEADINGS[11] - np.pi)


def sure_of(heading: int) -> Placements:
    weights = np.where(np.arange(12) == heading, 0.0, -np.inf)[None]
    return Placements(np.zeros((1, 12, 2)), np.ones((1, 12, 2, 2)), weights)


def test_an_axis_along_y_has_one_yaw() -> None:
    for off in (-1e-13, 0.0, 1e-13):
        assert moments(sure_of(6), np.array([[off, -9.0]])).yaw_rad[0] == pytest.approx(np.pi / 2)


ROUND, LONG = (0.7, 0.7, 1.75), (4.0, 1.7, 1.55)


@pytest.mark.parametrize("camera", [WEST, NORTH, EAST])
@pytest.mark.parametrize(("size", "class_id"), [(ROUND, PEDESTRIAN), (LONG, CAR)])
@given(x=st.floats(-6, 6), y=st.floats(-6, 6), yaw=st.sampled_from([0.0, 0.7, np.pi / 2]), seed=st.integers(0, 9))
def test_rounding_does_not_turn_an_object(
    camera: CameraSensor, size: tuple[float, float, float], class_id: int, x: float, y: float, yaw: float, seed: int
) -> None:
    found = {camera.name: seen_by(camera, [(x, y, size[2] / 2, *size, yaw)], [class_id])}
    sightings = see(views_of(camera), found)
    noise = 1 + 1e-12 * np.random.default_rng(seed).uniform(-1, 1, sightings.rays.shape)
    both = (placed(one) for one in (sightings, replace(sightings, rays=sightings.rays * noise)))
    yaws = [float(moments(one, sightings.origin[:, :2]).yaw_rad[0]) for one in both]
    assert abs(wrap_angle(yaws[1] - yaws[0])) < np.radians(0.1)
    if class_id == PEDESTRIAN:
        view = np.arctan2(y - sightings.origin[0, 1], x - sightings.origin[0, 0])
        assert abs(np.sin(yaws[0] - view)) < 0.1, "whose heading nobody sees looks along the view"
