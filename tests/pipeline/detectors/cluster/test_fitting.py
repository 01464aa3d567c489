"""Boxes of given classes fitted to groups of points."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.axes import Axes
from lidcam.pipeline.detectors.cluster.completion import Directions
from lidcam.pipeline.detectors.cluster.detector import ClusterDetector
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.protocols import Candidates3D

LIDAR = (0.0, 0.0, 1.8)
CONFIG = Config()
FITTER = BoxFitter(rig(LIDAR), CONFIG.classes, CONFIG.detect3d.cluster)
CAR, PEDESTRIAN, BICYCLE, TRUCK = 0, 1, 2, 3
CAR_BOX: Box = (12.0, 3.0, 0.75, 4.2, 1.75, 1.5, 0.3)
WALKER: Box = (7.0, -3.0, 0.9, 0.5, 0.5, 1.8, 0.0)
RIDER: Box = (6.0, 6.0, 0.85, 1.8, 0.5, 1.7, 1.2)


def scene(*boxes: Box, plane: Plane | None = None) -> tuple[CombinedCloud, I64, I64]:
    """The cloud of each box on its own, one after another, and their rows and starts."""
    clouds = [scan(LIDAR, [box]) for box in boxes]
    clouds = [cloud[cloud[:, 2] > CONFIG.detect3d.cluster.clearance_m] for cloud in clouds]
    starts = np.cumsum([0, *(len(cloud) for cloud in clouds)])
    return combined(np.concatenate(clouds), plane=plane), np.arange(starts[-1]), starts[:-1]


def assert_same(one: Candidates3D, other: Candidates3D, rows: list[int] | slice = slice(None)) -> None:
    """The first are the given rows of the second."""
    for name in Candidates3D._fields:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name)[rows], rtol=1e-9, err_msg=name)


def test_boxes_are_those_of_the_detector_where_it_finds_the_class() -> None:
    cloud, rows, starts = scene(CAR_BOX, WALKER, RIDER)
    fitted = FITTER(cloud, rows, starts, np.array([CAR, PEDESTRIAN, BICYCLE]))
    found = ClusterDetector(rig(LIDAR), CONFIG)(cloud)
    assert sorted(found.class_ids.tolist()) == [CAR, PEDESTRIAN, BICYCLE]
    order = [found.class_ids.tolist().index(class_id) for class_id in (CAR, PEDESTRIAN, BICYCLE)]
    # A beam over the far edge of a roof stands alone: it is in the group, and in no cluster.
    np.testing.assert_allclose(fitted.centers, found.centers[order], atol=0.03)
    np.testing.assert_allclose(fitted.sizes, found.sizes[order], atol=0.03)
    np.testing.assert_allclose(fitted.scores, found.scores[order], rtol=0.05)


def test_box_is_completed_with_the_size_of_the_given_class() -> None:
    cloud, rows, starts = scene((12.0, 0.0, 0.75, 1.0, 1.8, 1.5, 0.0))  # the rear of something
    lengths_m = CONFIG.classes[CAR].size_m[0], CONFIG.classes[TRUCK].kinds_m[0][0]  # the rear is as low as a van's
    for class_id, length in zip((CAR, TRUCK), lengths_m, strict=True):
        box = FITTER(cloud, rows, starts, np.array([class_id]))
        assert box.class_ids.tolist() == [class_id]
        assert box.sizes[0, 0] == pytest.approx(length)
        assert box.centers[0, 0] - length / 2 == pytest.approx(11.5, abs=0.05)


@pytest.mark.parametrize(
    ("points", "axis_deg", "log_odds", "expected_deg"),
    [
        pytest.param(slice(None), 30.0, 3.0, 17.2, id="many points that show another axis"),
        pytest.param(slice(None), 17.0, 3.0, 17.0, id="many points that show it, too"),
        pytest.param([30, 80, 120, 160], 30.0, 3.0, 30.0, id="few points"),
        pytest.param([30, 80, 120, 160], 120.0, 3.0, 30.0, id="across"),
        pytest.param([30, 80, 120, 160], 30.0, -np.inf, None, id="few points and nothing known"),
    ],
)
def test_an_expected_axis_is_taken_where_the_points_do_not_contradict(
    points: slice | list[int], axis_deg: float, log_odds: float, expected_deg: float | None
) -> None:
    cloud, rows, starts = scene(CAR_BOX)
    axes = Axes(np.deg2rad([axis_deg]), np.array([log_odds]))
    directions = Directions(np.array([CAR_BOX[6]]), np.array([0.3]), axes)
    box = FITTER(cloud, rows[points], starts, np.array([CAR]), directions)
    if expected_deg is None:
        directions = directions._replace(axes=Axes.unknown(1))
        assert_same(box, FITTER(cloud, rows[points], starts, np.array([CAR]), directions))
    else:
        assert np.rad2deg(box.yaws) == pytest.approx([expected_deg], abs=1.0)


def test_order_of_groups_and_points_does_not_matter() -> None:
    cloud, rows, starts = scene(CAR_BOX, WALKER, RIDER)
    classes = np.array([CAR, PEDESTRIAN, BICYCLE])
    straight = FITTER(cloud, rows, starts, classes)
    rng = np.random.default_rng(5)
    groups = [rng.permutation(group) for group in np.split(rows, starts[1:])][::-1]
    turned = np.cumsum([0, *map(len, groups)])[:-1]
    backward = FITTER(cloud, np.concatenate(groups), turned, classes[::-1])
    assert_same(straight, backward, [2, 1, 0])


def test_a_row_may_be_in_several_groups() -> None:
    cloud, rows, _ = scene(CAR_BOX)
    twice = FITTER(cloud, np.tile(rows, 2), np.array([0, len(rows)]), np.array([CAR, TRUCK]))
    for row, class_id in enumerate((CAR, TRUCK)):
        once = FITTER(cloud, rows, np.array([0]), np.array([class_id]))
        assert_same(once, twice, [row])


def test_single_points_and_no_groups() -> None:
    cloud, rows, _ = scene(CAR_BOX, WALKER)
    none = FITTER(cloud, rows[:0], rows[:0], rows[:0])
    assert [len(column) for column in none] == [0] * len(Candidates3D._fields)
    single = FITTER(cloud, rows[:3], np.arange(3), np.array([CAR, PEDESTRIAN, TRUCK]))
    assert single.class_ids.tolist() == [CAR, PEDESTRIAN, TRUCK]
    assert single.point_counts.tolist() == [1, 1, 1]
    for column in single:
        assert np.isfinite(column).all()
    assert (np.linalg.eigvalsh(single.covariances) > 0).all()


def test_boxes_stand_on_the_ground_and_say_when_they_were_measured() -> None:
    plane = Plane(np.array([0.0, 0.0, 1.0]), -0.1)
    cloud, rows, starts = scene(CAR_BOX, WALKER, plane=plane)
    points = cloud.detection_cloud
    time_ns = (np.arange(len(points)) * 1000).astype(np.int32)
    cloud = replace(cloud, detection_cloud=replace(points, time_offset_ns=time_ns))
    boxes = FITTER(cloud, rows, starts, np.array([CAR, PEDESTRIAN]))
    assert boxes.centers[:, 2] - boxes.sizes[:, 2] / 2 == pytest.approx(0.1)
    means = [time_ns[: starts[1]].mean(), time_ns[starts[1] :].mean()]
    assert boxes.time_offsets_ns == pytest.approx(np.rint(means), abs=1)


@pytest.mark.parametrize(("step_m", "height_m"), [(0.35, 1.75), (0.05, 1.5)])
def test_the_head_of_a_person_may_be_between_two_beams(step_m: float, height_m: float) -> None:
    y, z = np.meshgrid(np.linspace(-0.2, 0.2, 5), np.arange(1.45, 0.35, -step_m))
    cloud = combined(np.column_stack([np.full(y.size, 10.0), y.ravel(), z.ravel()]))
    box = FITTER(cloud, np.arange(y.size), np.array([0]), np.array([PEDESTRIAN]))
    assert box.sizes[0, 2] == pytest.approx(height_m, abs=0.06)
