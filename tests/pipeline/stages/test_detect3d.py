import numpy as np
import pytest
from detections import boxes3d
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.cluster import detector
from lidcam.pipeline.detectors.protocols import Candidates3D
from lidcam.pipeline.stages.detect3d import Detect3D, Recorded3D

LIDAR = (0.0, 0.0, 1.8)
GEOMETRIC = load_config(settings=("detect3d.score=geometric",))  # boxes of bare cuboids look like no car
CAR, BICYCLE = 0, 2


def car(x: float, y: float, yaw: float = 0.0) -> Box:
    return (x, y, 0.8, 4.2, 1.75, 1.5, yaw)


def detect(points: F64) -> Boxes3D:
    return Detect3D(rig(LIDAR), GEOMETRIC)(combined(points))


def assert_found(boxes: Boxes3D, truth: Box, *, within_m: float) -> int:
    distance = np.hypot(boxes.centers[:, 0] - truth[0], boxes.centers[:, 1] - truth[1])
    row = int(distance.argmin())
    assert distance[row] <= within_m
    off = (boxes.yaws[row] - truth[6]) % np.pi  # without motion front and rear look alike
    assert np.rad2deg(min(off, np.pi - off)) <= 3.0
    return row


@pytest.mark.parametrize(
    "truth",
    [
        pytest.param(car(12, 0), id="rear"),
        pytest.param(car(9, 5), id="corner"),
        pytest.param(car(-8, -6, 0.6), id="behind, turned"),
        pytest.param(car(20, 7, 2.5), id="far, turned"),
    ],
)
def test_car_seen_by_one_lidar(truth: Box) -> None:
    boxes = detect(scan(LIDAR, [truth], noise_m=0.01))
    assert len(boxes) == 1
    assert_found(boxes, truth, within_m=0.2)
    assert boxes.class_ids.tolist() == [CAR]
    assert boxes.centers[0, 2] - boxes.sizes[0, 2] / 2 == pytest.approx(0.0, abs=1e-9)
    assert boxes.sizes[0] == pytest.approx([4.1, 1.75, 1.55], abs=0.2)


def test_covariances_are_positive_definite_and_counts_are_those_of_the_cloud() -> None:
    points = scan(LIDAR, [car(12, 0), car(8, 9, 1.0)])
    boxes = detect(points)
    assert len(boxes) == 2
    assert (np.linalg.eigvalsh(boxes.covariances) > 0).all()
    usable = int((points[:, 2] > Config().detect3d.cluster.clearance_m).sum())
    assert 0.95 * usable <= boxes.point_counts.sum() <= usable  # single beams over the far edge of a roof stand alone
    assert (boxes.stamp_ns, boxes.frame_id) == (7, "site")


@pytest.mark.parametrize(
    ("lidars", "found"),
    [
        pytest.param([(-0.9, 0.0, 1.8)], [], id="on its roof"),
        pytest.param([(2.09, 0.0, 0.5)], [], id="in its bumper"),
        pytest.param([(-9.0, 0.0, 1.8), (0.0, 0.0, 1.9)], [], id="the second of two"),
        pytest.param([(0.0, 0.0, 5.0)], [0], id="on a gantry above"),
        pytest.param([(0.0, 1.2, 1.8)], [0], id="beside it"),
    ],
)
def test_the_vehicle_with_the_lidars_is_no_object(lidars: list[tuple[float, float, float]], found: list[int]) -> None:
    own = Candidates3D.of(boxes3d([car(0, 0)]), np.ones(1), combined(np.zeros((1, 3))))
    boxes = Detect3D(rig(*lidars), GEOMETRIC, detector=lambda _: own)(combined(np.zeros((1, 3))))
    assert boxes.class_ids.tolist() == found


@pytest.mark.parametrize(("gap_m", "range_m"), [(0.6, 7.0), (1.0, 14.0)])
def test_cars_parked_close_together_stay_apart(gap_m: float, range_m: float) -> None:
    step = 4.2 + gap_m
    row = [car(-step, range_m), car(0, range_m), car(step, range_m)]
    boxes = detect(scan(LIDAR, row))
    assert len(boxes) == 3
    for truth in row:
        assert_found(boxes, truth, within_m=0.35)


def test_branch_over_a_car_is_no_part_of_it() -> None:
    crown: Box = (11.0, 3.0, 3.2, 6.0, 4.0, 1.4, 0.3)
    boxes = detect(scan(LIDAR, [car(11, 2), crown], rings=(-24.8, 15.0, 96)))
    row = assert_found(boxes, car(11, 2), within_m=0.25)
    assert boxes.sizes[row, 2] == pytest.approx(1.5, abs=0.15)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(np.zeros((0, 3)), id="empty"),
        pytest.param(np.array([[9.0, 1.0, 1.0]]), id="one"),
        pytest.param(np.tile([[9.0, 1.0, 1.0]], (50, 1)), id="all in one place"),
        pytest.param(np.linspace([5, -30, 1], [5, 30, 1], 3000), id="line"),
        pytest.param(np.linspace([8, 0, -0.2], [9, 0, 0.2], 200), id="below the clearance"),
        pytest.param(np.linspace([8, 0, 2.5], [9, 1, 3.5], 200), id="hanging"),
        pytest.param(scan(LIDAR, [(15.0, 0.0, 2.0, 0.3, 40.0, 4.0, 0.0)]), id="wall"),
        pytest.param(scan(LIDAR, [(15.0, 0.0, 5.0, 5.0, 5.0, 10.0, 0.0)], rings=(-20, 25, 64)), id="house"),
    ],
)
def test_what_is_no_road_user_gives_no_box(points: F64) -> None:
    assert len(detect(points)) == 0


def test_another_engine_needs_no_change_of_the_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """As from a network: an unknown class, overlapping boxes, any turn of yaw, no point counts or covariances."""
    x = np.array([30.0, 10.0, 10.5, 20.0, 0.0, 5.0])
    centers = np.stack([x, np.zeros(6), np.ones(6)], 1)
    proposals = Candidates3D(
        centers,
        np.tile([4.0, 1.8, 1.5], (6, 1)),
        np.array([0.1, -np.pi, 0.0, -3.0 - 2 * np.pi, 0.0, 0.0]),
        np.array([0.5, 0.9, 0.8, 0.5, 0.06, 0.7], np.float32).astype(np.float64),
        np.array([CAR, BICYCLE, CAR, CAR, CAR, -1]),
        np.zeros(6, np.int64),
        np.zeros((6, 3, 3)),
        np.arange(6),
    )
    monkeypatch.setattr(detector, "ClusterDetector", lambda *_: lambda _: proposals)
    boxes = detect(np.zeros((0, 3)))
    assert boxes.centers[:, 0].tolist() == [10, 20, 30], "falling score, then x"
    assert boxes.class_ids.tolist() == [BICYCLE, CAR, CAR], "the better of two overlapping boxes, of any classes"
    assert boxes.yaws == pytest.approx([np.pi, -3.0, 0.1])
    assert not boxes.point_counts.any()
    assert not boxes.covariances.any()
    assert boxes.measured_ns.tolist() == [8, 10, 7]


# --- boxes that detectors recorded


RIG = Rig(
    "site", (), (), (), detectors=tuple(RecordedDetector(name, f"/{name}", "site", {}) for name in ("a", "b", "c"))
)
FRAME = SensorBundle(0, 1, 1, {})


def at(*places: float, scores: list[float] | None = None) -> Boxes3D:
    return boxes3d([(x, 0, 0.8, 4, 2, 1.5, 0.0) for x in places], scores=scores)


@pytest.mark.parametrize(
    ("found", "x", "scores"),
    [
        (
            {"b": at(20, 50, scores=[0.3, 0.9]), "a": at(10, 0, scores=[0.3, 0.6])},
            [50, 0, 10, 20],
            [0.9, 0.6, 0.3, 0.3],
        ),
        (
            {"a": at(0, 30, scores=[0.5, 0.6]), "b": at(0.5, scores=[0.7]), "c": at(30.2, scores=[0.6])},
            [0.5, 30],
            [0.7, 0.6],
        ),
        ({"a": at(0, 0.5, 1, scores=[0.5] * 3)}, [0, 0.5, 1], [0.5] * 3),
        ({"a": at(0, 10, 20, scores=[0.5] * 3), "b": at(0, 10, 40, scores=[0.5] * 3)}, [0, 10, 20, 40], [0.5] * 4),
        ({}, [], []),
        ({"a": at()}, [], []),
        ({"a": at(), "c": at()}, [], []),
    ],
    ids=["better ones first", "the better of two detectors", "next to itself", "alike", "no message", "none", "none"],
)
def test_recorded_boxes_are_joined_whatever_the_order_of_the_messages(
    found: dict[str, Boxes3D], x: list[float], scores: list[float]
) -> None:
    joined = Recorded3D(RIG)(FRAME, found)
    assert joined.centers[:, 0].tolist() == x
    np.testing.assert_array_equal(joined.scores, np.array(scores, np.float32))
    assert (joined.stamp_ns, joined.frame_id) == (1, "site")
    other = Recorded3D(RIG)(FRAME, dict(reversed(found.items())))
    for name in ("centers", "sizes", "yaws", "scores", "class_ids", "point_counts", "covariances", "measured_ns"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(other, name), err_msg=name)
