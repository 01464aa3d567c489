import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog

from lidcam.bags.simulator.vehicles.footprints import Rectangle, discs_of, obstacles_of, overlap
from lidcam.bags.simulator.world.mesh import METAL, box, cylinder, merged, polygon
from lidcam.pipeline.core.arrays import F64

PLACE, TURN, SIZE = st.floats(-4, 4), st.floats(-7, 7), st.floats(0.1, 5)
RECTANGLE = st.builds(Rectangle, PLACE, PLACE, TURN, SIZE, SIZE)


def corners(of: Rectangle) -> F64:
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * (of.length_m, of.width_m)
    cos, sin = math.cos(of.yaw_rad), math.sin(of.yaw_rad)
    return np.asarray(signs @ np.array([[cos, sin], [-sin, cos]]) + (of.x_m, of.y_m))


def room_in_both(one: Rectangle, other: Rectangle) -> float:
    """Radius of the largest disc inside both; negative where they are apart."""
    normals, limits = [], []
    for each in (one, other):
        for turn, half in ((0.0, each.length_m / 2), (math.pi / 2, each.width_m / 2)):
            normal = np.array([math.cos(each.yaw_rad + turn), math.sin(each.yaw_rad + turn)])
            middle = float(normal @ (each.x_m, each.y_m))
            normals += [normal, -normal]
            limits += [half + middle, half - middle]
    table = np.c_[normals, np.ones(len(normals))]
    best = linprog([0, 0, -1], A_ub=table, b_ub=limits, bounds=[(None, None)] * 3)
    assert best.x is not None
    return float(best.x[2])


@given(RECTANGLE, RECTANGLE)
def test_rectangles_overlap_where_there_is_room_in_both(one: Rectangle, other: Rectangle) -> None:
    room_m = room_in_both(one, other)
    assume(abs(room_m) > 1e-6)
    assert overlap(one, other) == overlap(other, one) == (room_m > 0)


@given(RECTANGLE, st.floats(0, 1), st.floats(0, 1))
def test_discs_cover_their_rectangle(rectangle: Rectangle, along: float, across: float) -> None:
    a, b, _, d = corners(rectangle)
    point = a + along * (b - a) + across * (d - a)
    discs, rows = discs_of([rectangle])
    assert (np.hypot(*(discs[:, :2] - point).T) <= discs[:, 2] + 1e-9).any()
    assert set(rows) == {0}


def test_bodies_in_the_way_are_obstacles_and_those_above_and_below_are_not() -> None:
    ground = polygon([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], METAL)
    kerb, crown = box((0, 5, 0.06), (4, 1, 0.12), METAL), box((3, 3, 4), (2, 2, 2), METAL)
    wall, post = box((1, 2, 0.5), (3, 0.2, 1.0), METAL, yaw=0.3), cylinder((-2, 0, 0), (-2, 0, 3), 0.1, METAL)
    found = obstacles_of(merged(ground, kerb, wall, crown, post), step_m=0.2, headroom_m=2.0)
    assert len(found) == 2
    wall_found = next(each for each in found if each.x_m > 0)
    expected = corners(Rectangle(1, 2, 0.3, 3, 0.2))
    gaps = np.hypot(*np.moveaxis(corners(wall_found)[:, None] - expected, -1, 0)).min(1)
    np.testing.assert_allclose(gaps, 0, atol=1e-4)
