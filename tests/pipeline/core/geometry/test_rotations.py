import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.geometry.rotations import (
    matrix_of_quaternion,
    matrix_of_rpy,
    quaternion_of_matrix,
    rotation_vectors,
    turned,
)

ANGLES = st.tuples(*[st.floats(-10, 10)] * 3)
QUATERNIONS = st.tuples(*[st.floats(-2, 2)] * 4).filter(lambda xyzw: math.hypot(*xyzw) > 1e-3)
QUARTERS = [(x, y, z) for x in (0, 0.5, 1, -0.5) for y in (0, 0.5, 1, -0.5) for z in (0, 0.5, 1, -0.5)]


def same(found: np.ndarray, expected: np.ndarray) -> bool:
    """Equal but for the last digits, which a compiler may round otherwise."""
    return found.shape == expected.shape and bool(np.abs(found - expected).max(initial=0) <= 4e-16)


@given(QUATERNIONS)
def test_matrix_of_a_quaternion_is_that_of_scipy(xyzw: tuple[float, ...]) -> None:
    assert same(matrix_of_quaternion(xyzw), Rotation.from_quat(xyzw).as_matrix())


@given(ANGLES)
def test_matrix_of_angles_is_that_of_scipy(rpy: tuple[float, float, float]) -> None:
    assert same(matrix_of_rpy(rpy), Rotation.from_euler("xyz", rpy).as_matrix())


@given(ANGLES)
def test_quaternion_of_a_matrix_is_that_of_scipy(rpy: tuple[float, float, float]) -> None:
    matrix = Rotation.from_euler("xyz", rpy).as_matrix()
    assert same(quaternion_of_matrix(matrix), Rotation.from_matrix(matrix).as_quat(canonical=True))


@pytest.mark.parametrize("quarters", QUARTERS)
def test_quarter_turns_where_signs_and_choices_are_ties(quarters: tuple[float, ...]) -> None:
    matrix = np.round(Rotation.from_euler("xyz", np.multiply(quarters, np.pi)).as_matrix())
    found = quaternion_of_matrix(matrix)
    assert same(found, Rotation.from_matrix(matrix).as_quat(canonical=True))
    assert same(matrix_of_quaternion(found), matrix)


def test_of_many_quaternions() -> None:
    many = np.random.default_rng(1).normal(size=(5, 7, 4))
    expected = Rotation.from_quat(many.reshape(-1, 4)).as_matrix().reshape(5, 7, 3, 3)
    assert same(matrix_of_quaternion(many), expected)
    assert matrix_of_quaternion(np.zeros((0, 4))).shape == (0, 3, 3)


def test_the_rotation_nearest_to_a_rounded_matrix() -> None:
    rounded = np.round(matrix_of_rpy([0.1, -0.7, 2.0]), 3)
    assert same(quaternion_of_matrix(rounded), Rotation.from_matrix(rounded).as_quat(canonical=True))


@pytest.mark.parametrize("diagonal", [(1, 1, -1), (0, 0, 0), (1, 1, 0)])
def test_what_is_no_rotation_is_refused(diagonal: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected a rotation"):
        quaternion_of_matrix(np.diag(diagonal).astype(np.float64))


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda xyz: math.hypot(*xyz) > 1e-3), st.floats(0, math.pi - 1e-9))
def test_rotation_vectors_are_those_of_scipy(axis: tuple[float, float, float], angle_rad: float) -> None:
    vector = np.array(axis) / np.linalg.norm(axis) * angle_rad
    judge = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(turned(vector), judge.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation_vectors(judge.as_matrix()[None]), [vector], atol=1e-14)


def test_no_rotations_have_no_vectors() -> None:
    assert rotation_vectors(np.zeros((0, 3, 3))).shape == (0, 3)
    assert turned(np.zeros((0, 3))).shape == (0, 3, 3)
