"""Features of boxes, judged by array operations on the points of one box at a time."""

import numpy as np
import pytest
from detections import boxes3d

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.detectors.cluster.features import FEATURES, box_features

LIDARS = np.array([[0.0, 0.0], [30.0, 5.0]])
BOX = np.array([10.0, 4.0, 0.9, 4.0, 1.8, 1.8, 0.6])  # x, y, z, length, width, height, yaw


def features(points: F64, *rows: F64) -> dict[str, F64]:
    """Those of boxes that all have the same points; by name."""
    boxes = boxes3d(list(rows))
    starts = np.arange(len(rows) + 1) * len(points)
    found = box_features(boxes, np.ones(len(rows), np.int64), np.tile(points, (len(rows), 1)), starts, LIDARS)
    return dict(zip(FEATURES, found.T, strict=True))


def cloud(count: int) -> F64:
    """Points about the box, in the site frame, with heights above the ground."""
    return np.random.default_rng(0).uniform([6, 1, 0], [14, 7, 4.5], (count, 3))


def test_columns_mean_what_they_are_called() -> None:
    points = cloud(3000)
    found = features(points, BOX)
    off = points[:, :2] - BOX[:2]
    x = off @ [np.cos(BOX[6]), np.sin(BOX[6])]
    y = off @ [-np.sin(BOX[6]), np.cos(BOX[6])]
    z = points[:, 2]
    beside_x, beside_y = np.abs(x) - BOX[3] / 2, np.abs(y) - BOX[4] / 2
    within = (beside_x <= 0.15) & (beside_y <= 0.15)
    inside, above = within & (z <= 1.95), within & (z > 1.95) & (z <= 3.95)
    ring = ~within & (beside_x <= 1) & (beside_y <= 1) & (z < 3)
    nearer = ring & (off @ -BOX[:2] > 0)  # of the first lidar, in the origin
    counted = {
        "at_ends": ring & (beside_y <= 0.15),
        "at_sides": ring & (beside_x <= 0.15),
        "nearer": nearer,
        "farther": ring & ~nearer,
        "around_high": ring & (z > 1.2),
        "above": above,
    }
    points_inside = np.log1p(inside.sum())
    expected = {name: np.log1p(mask.sum()) - points_inside for name, mask in counted.items()}
    range_m, sight = np.hypot(*BOX[:2]), np.arctan2(BOX[1], BOX[0])
    x, y, z = x[inside], y[inside], z[inside]
    variance, axes = np.linalg.eigh(np.cov(x, y, bias=True))
    across, along = np.column_stack([x - x.mean(), y - y.mean()]) @ axes[:, 0], np.column_stack([x, y]) @ axes[:, 1]
    low = z < 0.6
    depth = np.abs(np.minimum(BOX[3] / 2 - np.abs(x), BOX[4] / 2 - np.abs(y)))
    expected |= {"score": 0.0, "range": np.log(range_m), "length": 4.0, "car": 1.0, "points": points_inside}
    expected |= {"turn": np.abs(np.cos(sight - BOX[6])), "density": points_inside + 2 * np.log(range_m)}
    expected |= {"low": z.min(), "mean": z.mean(), "top": z.max(), "spread": z.std()}
    expected |= {"layer2": np.mean((z >= 0.6) & (z < 0.9)), "layer6": np.mean(z >= 1.9)}
    expected |= {"thin": np.sqrt(variance[0]), "long": np.sqrt(variance[1])}
    expected |= {"along": np.ptp(along), "across": np.ptp(across), "on_axis": np.mean(np.abs(across) < 0.1)}
    expected |= {"profile0x": np.ptp(along[low]), "profile0y": np.ptp(across[low])}
    expected |= {"side": depth.mean(), "side_spread": depth.std(), "inside": np.mean(depth > 0.3)}
    assert {name: found[name][0] for name in expected} == pytest.approx(expected, abs=1e-9)
    lean = np.abs(np.mean(across * (z - z.mean())))  # the axis may point either way
    assert np.abs(found["lean"][0]) == pytest.approx(lean, abs=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_points(count: int) -> None:
    points = np.tile([BOX[0], BOX[1], 1.0], (count, 1))
    found = features(points, BOX)
    assert all(np.isfinite(column).all() for column in found.values())
    assert found["points"][0] == pytest.approx(np.log1p(count))
    assert found["low"][0] == (1.0 if count == 3 else 0.0)


def test_each_box_has_its_own_and_no_box_none() -> None:
    points, other = cloud(500), BOX + np.array([1.0, 0.5, 0, 0, 0, 0, 0.3])
    both = features(points, BOX, other)
    for row, box in enumerate((BOX, other)):
        assert {name: values[row] for name, values in both.items()} == {
            name: values[0] for name, values in features(points, box).items()
        }
    assert all(len(column) == 0 for column in features(points[:0]).values())


def test_the_same_seen_from_another_side_of_the_site() -> None:
    """Rotated about the nearest lidar together with its points, a box has the same features."""
    points, turn = cloud(1000), 2.1
    cos, sin = np.cos(turn), np.sin(turn)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ [[cos, sin], [-sin, cos]]
    box = np.array([*(BOX[:2] @ [[cos, sin], [-sin, cos]]), *BOX[2:6], BOX[6] + turn])
    one, other = features(points, BOX), features(turned, box)
    assert {n: v[0] for n, v in other.items()} == pytest.approx({n: v[0] for n, v in one.items()}, abs=1e-9)


@pytest.mark.parametrize(
    ("kind", "top_m", "height"),
    [
        pytest.param(2, 1.5, 1.5, id="head of a person between two beams"),
        pytest.param(3, 1.5, 1.5, id="of a rider"),
        pytest.param(2, 1.4, 1.8, id="head hidden"),
        pytest.param(1, 1.5, 1.8, id="car"),
    ],
)
def test_heights_of_people_count_as_far_as_they_are_seen(kind: int, top_m: float, height: float) -> None:
    points = np.column_stack([np.full((9, 2), BOX[:2]), np.linspace(0.4, top_m, 9)])
    found = box_features(boxes3d([BOX]), np.array([kind]), points, np.array([0, 9]), LIDARS)
    assert found[0, FEATURES.index("height")] == pytest.approx(height)
