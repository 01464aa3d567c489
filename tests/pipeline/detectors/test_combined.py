"""Boxes of a network and of clusters in one list: geometry by the points, existence by both."""

from pathlib import Path

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan
from pillar_files import numbers_of, write_pillars

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.cluster.network import ClusterNetwork
from lidcam.pipeline.detectors.combined import CLUSTER_BONUS, FITTED, NEAR_M
from lidcam.pipeline.stages.detect3d import Detect3D

LIDAR = (0.0, 0.0, 1.8)
CAR: Box = (8.2, -3.1, 0.75, 4.2, 1.75, 1.5, 2.5)
TURNED: Box = (-7.0, 6.0, 0.75, 4.2, 1.75, 1.5, -2.2)
FEW: Box = (5.0, 9.0, 0.75, 4.2, 1.75, 1.5, 0.0)
FAR: Box = (-22.0, 3.0, 0.75, 4.2, 1.75, 1.5, 0.3)
TRUCK: Box = (2.0, -3.75, 1.6, 8.0, 2.5, 3.2, 0.0)
MIRROR: Box = (-1.0, -2.6, 0.9, 0.4, 0.4, 1.8, 0.0)
PERSON: Box = (6.0, 2.0, 0.9, 0.4, 0.4, 1.8, 0.0)
OFF = np.array([0.15, -0.1, 0.0, -0.2, 0.1, 0.1, 0.2])
"""What the network is wrong by: in place, size and heading."""

LEARNED = dict(zip(KINDS, (0.05, 0.6, 0.3, 0.03, 0.02), strict=True))
LOG_ODDS = 3.0


def detector(
    tmp_path: Path,
    boxes: list[F64],
    names: tuple[str, ...] = ("car",),
    method: str = "combined",
    last: int = 0,
    recorded: bool = False,
) -> Detect3D:
    """With a network that finds these boxes with `LOG_ODDS`; the score of clusters is `LEARNED`.

    They are of the first class, the last one of class `last`.
    """
    rows = np.array(boxes).reshape(-1, 7)
    odds, classes = np.full(len(rows), LOG_ODDS), [0] * (len(rows) - 1) + [last] * (len(rows) > 0)
    numbers = numbers_of(rows[:, :3], rows[:, 3:6], rows[:, 6], odds, classes, len(names))
    model = write_pillars(tmp_path / "net.onnx", numbers, [{"name": one, "recorded": recorded} for one in names])
    weights = tmp_path / "net.npz"
    said = np.log(list(LEARNED.values()))
    layer = np.zeros((1, len(FEATURES), len(KINDS))), said[None, None]
    none = np.zeros(len(FEATURES))
    weights.write_bytes(ClusterNetwork(none, none + 1, (layer[0],), (layer[1],)).to_bytes())
    settings = f"detect3d.model={model}", f"detect3d.weights={weights}", "detect3d.score=learned"
    return Detect3D(rig(LIDAR), load_config("road", (*settings, f"detect3d.method={method}")))


def at(boxes: Boxes3D, box: Box) -> Boxes3D:
    """The one box there."""
    found = boxes.select(np.linalg.norm(boxes.centers[:, :2] - box[:2], axis=1) < 1)
    assert len(found) == 1
    return found


def logit(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def log_odds(boxes: Boxes3D, box: Box) -> float:
    return logit(float(at(boxes, box).scores[0]))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[5.0, 1.0, 1.0]])], ids=["empty", "one"])
def test_nothing_is_found_where_nothing_is_seen(tmp_path: Path, points: F64) -> None:
    assert not len(detector(tmp_path, [np.array(CAR)])(combined(points)))


def test_points_say_where_and_the_network_which_way(tmp_path: Path) -> None:
    """Clusters have their headings in (-90, 90] degrees, both cars and the network others."""
    detect = detector(tmp_path, [np.add(CAR, OFF), np.add(TURNED, OFF)])
    boxes = detect(combined(scan(LIDAR, [CAR, TURNED])))
    assert boxes.class_ids.tolist() == [0, 0]
    both = FITTED.both[KINDS.index("car")]
    for box in (CAR, TURNED):
        found = at(boxes, box)
        np.testing.assert_allclose(found.centers[0, :2], box[:2], atol=0.12)
        np.testing.assert_allclose(found.yaws, box[6], atol=0.03)
        expected = both[0] + both[1] * logit(LEARNED["car"] + LEARNED["large vehicle"]) + both[2] * LOG_ODDS
        assert log_odds(boxes, box) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("place", "other", "is_alike"), [(CAR, "truck", True), (FAR, "truck", False), (CAR, "barrier", False)]
)
def test_a_tall_car_is_no_less_there_for_looking_like_a_truck(
    tmp_path: Path, place: Box, other: str, is_alike: bool
) -> None:
    cloud, found = combined(scan(LIDAR, [CAR, FAR])), [np.array(CAR), np.add(place, OFF)]
    boxes = detector(tmp_path, found, ("car", other), "pillars", last=1)(cloud)
    assert at(boxes, CAR).class_ids[0] == 0
    doubt = 1 / (1 + np.exp(LOG_ODDS))
    np.testing.assert_allclose(at(boxes, CAR).scores[0], 1 - doubt ** (1 + is_alike), rtol=1e-4)


ROW: list[Box] = [(x, y, 0.75, 4.2, 1.75, 1.5, 0.3) for x, y in ((4.0, -4.0), (10.0, -4.0), (-4.0, -6.0))]


def test_cars_around_tell_the_axis_of_one_with_few_points(tmp_path: Path) -> None:
    hard: Box = (9.0, 8.0, *ROW[0][2:])
    points, said = scan(LIDAR, [hard])[::40], np.add(hard, 1.5 * OFF)
    alone = detector(tmp_path, [said])(combined(points))
    assert abs(at(alone, hard).yaws[0] - hard[6]) > 0.25
    cloud = combined(np.concatenate([points, scan(LIDAR, ROW)]))
    boxes = detector(tmp_path, [*map(np.array, ROW), said])(cloud)
    assert at(boxes, hard).yaws[0] == pytest.approx(hard[6], abs=0.02)


def test_what_one_of_them_misses(tmp_path: Path) -> None:
    """A car of too few points for a cluster, one beyond the grid, and one that the network should have found."""
    few = scan(LIDAR, [FEW])[::400]
    cloud = combined(np.concatenate([scan(LIDAR, [CAR, FAR]), few]))
    clusters, both = detector(tmp_path, [], method="cluster")(cloud), detector(tmp_path, [np.array(FEW)])(cloud)
    assert (len(clusters), len(both)) == (2, 3)
    assert log_odds(both, FEW) > log_odds(both, FAR) == pytest.approx(logit(LEARNED["car"]), abs=1e-3)
    alone = FITTED.alone[KINDS.index("car")]
    assert log_odds(both, CAR) == pytest.approx(alone[0] + alone[1] * logit(LEARNED["car"]), abs=1e-3)


def test_of_people_only_a_network_that_recordings_calibrated_raises_the_learned_score(tmp_path: Path) -> None:
    cloud, boxes, names = combined(scan(LIDAR, [PERSON])), [np.array(PERSON)], ("pedestrian", "car")
    assert log_odds(detector(tmp_path, boxes, names, "pillars")(cloud), PERSON) == pytest.approx(LOG_ODDS)
    found = at(detector(tmp_path, boxes, names)(cloud), PERSON)
    np.testing.assert_allclose(found.scores, LEARNED["pedestrian"], rtol=1e-3)
    both, learned = FITTED.both[KINDS.index("pedestrian")], logit(LEARNED["pedestrian"])
    found = detector(tmp_path, boxes, names, recorded=True)(cloud)
    assert log_odds(found, PERSON) == pytest.approx(both[0] + both[1] * learned + both[2] * LOG_ODDS, abs=1e-3)


def test_a_truck_beside_the_lidar(tmp_path: Path) -> None:
    """A mirror that the network takes for a person does not rule it out, and its many points speak for it."""
    cloud = combined(scan(LIDAR, [TRUCK]))
    boxes = detector(tmp_path, [np.array(TRUCK), np.array(MIRROR)], ("truck", "pedestrian"), last=1)(cloud)
    both, learned = FITTED.both[KINDS.index("large vehicle")], logit(LEARNED["large vehicle"])
    near = np.log(at(boxes, TRUCK).point_counts[0]) * (1 - (abs(TRUCK[1]) - TRUCK[4] / 2) / NEAR_M)
    expected = both[0] + both[1] * learned + both[2] * LOG_ODDS + Config().detect3d.near_weight * near
    assert log_odds(boxes, TRUCK) == pytest.approx(expected, abs=0.1)


def test_the_order_of_points_does_not_matter(tmp_path: Path) -> None:
    points = scan(LIDAR, [CAR, FAR, PERSON])
    detect = detector(tmp_path, [np.add(CAR, OFF)])
    first, again = detect(combined(points)), detect(combined(np.random.default_rng(0).permutation(points)))
    for name in ("centers", "sizes", "yaws", "scores", "class_ids", "covariances"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_a_network_that_knows_no_cars_does_not_speak_against_them(tmp_path: Path) -> None:
    boxes = detector(tmp_path, [], ("pedestrian",))(combined(scan(LIDAR, [CAR])))
    np.testing.assert_allclose(boxes.scores, LEARNED["car"], rtol=1e-3)


def unknown(tmp_path: Path, name: str, classes: str, method: str = "combined") -> Detect3D:
    """With classes that the learned score does not know, and a network that finds the car as one of them."""
    row = np.array(CAR)[None]
    numbers = numbers_of(row[:, :3], row[:, 3:6], row[:, 6], np.array([LOG_ODDS]), [0], 1)
    model = write_pillars(tmp_path / "net.onnx", numbers, [{"name": name}])
    settings = f"classes=[{classes}]", f"detect3d.model={model}", "detect3d.score=geometric"
    return Detect3D(rig(LIDAR), load_config("road", (*settings, f"detect3d.method={method}")))


CART = "{name: cart, size_m: [4.2, 1.75, 1.5], max_size_m: [5, 2, 2]}"


def test_clusters_of_one_unknown_class_are_not_joined_with_boxes_of_another(tmp_path: Path) -> None:
    sled = "{name: sled, size_m: [3, 1, 1], max_size_m: [4, 2, 2]}"
    boxes = unknown(tmp_path, "sled", f"{CART}, {sled}")(combined(scan(LIDAR, [CAR])))
    assert boxes.class_ids.tolist() == [1]
    assert log_odds(boxes, CAR) == pytest.approx(LOG_ODDS, abs=1e-3)


def test_classes_that_the_learned_score_does_not_know(tmp_path: Path) -> None:
    """Clusters that the network finds, too, have its score; those that it is silent of have a lower one."""
    cloud = combined(scan(LIDAR, [CAR, TURNED]))
    both, clusters = (unknown(tmp_path, "cart", CART, method)(cloud) for method in ("combined", "cluster"))
    assert len(both) == 2
    assert log_odds(both, CAR) == pytest.approx(LOG_ODDS + CLUSTER_BONUS, abs=1e-3)
    alone = FITTED.alone[0]
    assert log_odds(both, TURNED) == pytest.approx(alone[0] + alone[1] * log_odds(clusters, TURNED), abs=1e-3)


def test_what_is_lacking() -> None:
    config = load_config("road", ("detect3d.method=combined",))
    with pytest.raises(ModelError, match=r"detect3d\.method combined needs a network: give --model-3d"):
        Detect3D(rig(LIDAR), config)
