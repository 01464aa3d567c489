from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera

from pipeline.core.arrays import F64, I64
from pipeline.core.detections import Boxes3D
from pipeline.fusion.projection import CameraArrays
from pipeline.fusion.refining.edges import MeasuredEdges
from pipeline.fusion.refining.refinement import TURNED_COST, RefinedBoxes, better_turned, with_turned

RIDER, WALKER = (1.8, 0.6, 1.7), (0.6, 0.6, 1.75)


def made(*rows: tuple[tuple[float, float, float], float, float]) -> Boxes3D:
    """Boxes of a size, a heading and a standard deviation of that; known better along x than along y."""
    values = [(5.0 * k, 1.0, 0.9, *size, yaw) for k, (size, yaw, _) in enumerate(rows)]
    boxes = boxes3d(np.array(values).reshape(-1, 7), deviations=(0.1, 0.4, 1.0))
    covariances = boxes.covariances.copy()
    covariances[:, 2, 2] = [std**2 for *_, std in rows]
    return replace(boxes, covariances=covariances)


def pairs(*rows: int) -> MeasuredEdges:
    n = len(rows)
    cameras = CameraArrays.of([forward_camera()] * n)
    xyxy, noise = np.arange(4.0 * n).reshape(n, 4), np.ones((n, 4))
    return MeasuredEdges(np.array(rows, np.int64), np.zeros(n, np.int64), cameras, xyxy, noise, 0 * noise, np.zeros(n))


@pytest.mark.parametrize(
    ("rows", "edges", "turned"),
    [
        ((), (), []),
        (((RIDER, 0.3, 0.1),), (0,), []),
        (((RIDER, 0.3, 0.9),), (), []),
        (((WALKER, 0.3, 0.9),), (0,), []),
        (((RIDER, 0.3, 0.9),), (0, 0), [0]),
        (((RIDER, 0.3, 0.9), (WALKER, 0.0, 0.9), (RIDER, 1.6, 0.9), (RIDER, 0.0, 0.9)), (0, 1, 1, 3), [0, 3]),
    ],
)
def test_long_boxes_of_unknown_heading_are_turned(
    rows: tuple[tuple[tuple[float, float, float], float, float], ...], edges: tuple[int, ...], turned: list[int]
) -> None:
    boxes, own = made(*rows), pairs(*edges)
    all_boxes, all_edges, stands_for = with_turned(boxes, own)
    assert stands_for.tolist() == [*range(len(boxes)), *turned]
    assert len(all_boxes) == len(stands_for)
    assert (np.diff(all_edges.rows) >= 0).all()
    again = [number for number in edges if number in turned]
    assert stands_for[all_edges.rows].tolist() == [*edges, *again]
    np.testing.assert_array_equal(all_edges.xyxy[len(edges) :], own.xyxy[[k in turned for k in edges]])
    np.testing.assert_array_equal(all_boxes.centers, boxes.centers[stands_for])
    for row, of in enumerate(turned, len(boxes)):
        assert np.cos(2 * (all_boxes.yaws[row] - boxes.yaws[of])) == pytest.approx(-1)
        for k in (row, of):
            assert np.sqrt(all_boxes.covariances[k, 2, 2]) == pytest.approx(np.pi / 2 / np.sqrt(12))
        np.testing.assert_allclose(np.diag(all_boxes.covariances[row])[:2], np.diag(boxes.covariances[of])[[1, 0]])


def found(costs: F64, accepted: list[bool]) -> RefinedBoxes:
    n = len(costs)
    nothing = np.zeros(n)
    zeros = np.zeros((n, 2)), nothing, np.zeros((n, 2)), np.zeros((n, 3, 3)), nothing
    return RefinedBoxes(*zeros, np.array(accepted, np.bool_), costs)


@pytest.mark.parametrize(
    ("cost", "accepted", "better"),
    [
        (0.0, [True, True], [True, False]),
        (-TURNED_COST - 0.1, [True, True], [False, True]),
        (-TURNED_COST + 0.1, [True, True], [True, False]),
        (9.0, [False, True], [False, True]),
        (-9.0, [True, False], [True, False]),
    ],
)
def test_the_likelier_one_is_taken(cost: float, accepted: list[bool], better: list[bool]) -> None:
    objects, stands_for = np.array([0, 2, 3]), np.array([0, 1, 2, 2])
    fits = found(np.array([7.0, 5.0, 5.0 + cost]), [True, *accepted])
    assert better_turned(objects, fits, stands_for).tolist() == [True, *better]


def test_nothing_found() -> None:
    none: I64 = np.zeros(0, np.int64)
    assert len(better_turned(none, found(np.zeros(0), []), none)) == 0
