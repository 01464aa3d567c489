import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from transforms import shift, transforms, vectors

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.transform import Transform, rotation_fault


@given(transforms())
def test_a_transform_and_its_inverse_cancel(T_b_a: Transform) -> None:
    both = T_b_a.inverse() @ T_b_a
    assert (both.dst, both.src) == ("a", "a")
    np.testing.assert_allclose(both.matrix, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(T_b_a.inverse().matrix, np.linalg.inv(T_b_a.matrix), atol=1e-9)


@given(transforms("c", "b"), transforms("b", "a"), st.lists(vectors, min_size=1, max_size=5))
def test_chaining_is_applying_one_after_the_other(
    T_c_b: Transform, T_b_a: Transform, points: list[tuple[float, ...]]
) -> None:
    xyz = np.array(points)
    chained = T_c_b @ T_b_a
    assert (chained.dst, chained.src) == ("c", "a")
    np.testing.assert_allclose(chained.apply(xyz), T_c_b.apply(T_b_a.apply(xyz)), atol=1e-8)


@given(transforms())
def test_quaternions_round_trip(T_b_a: Transform) -> None:
    again = Transform.from_quaternion("b", "a", T_b_a.translation, T_b_a.quaternion_xyzw)
    np.testing.assert_allclose(again.matrix, T_b_a.matrix, atol=1e-12)
    assert T_b_a.quaternion_xyzw[3] >= 0


def test_chaining_unlike_frames_is_refused() -> None:
    with pytest.raises(FrameError, match="cannot chain b<-a with c<-b"):
        shift("b", "a", 1) @ shift("c", "b", 1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(3,), (0, 3), (4, 3), (2, 5, 3)])
def test_apply_keeps_shape_and_dtype(dtype: type, shape: tuple[int, ...]) -> None:
    moved = shift("b", "a", 1).apply(np.zeros(shape, dtype))
    assert (moved.shape, moved.dtype) == (shape, np.dtype(dtype))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, np.nan), (0, 0, 0, np.inf)])
def test_a_quaternion_without_length_is_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(FrameError, match="unit quaternion"):
        Transform.from_quaternion("b", "a", [0, 0, 0], quaternion)


@pytest.mark.parametrize(
    ("matrix", "fault"),
    [
        (np.eye(3), None),
        (np.eye(3) + 4e-4, None),  # three digits
        (np.diag([1.0, 1.0, 0.0]), "singular"),
        (np.zeros((3, 3)), "singular"),
        (np.diag([1.0, 1.0, -1.0]), "reflection"),
        (np.diag([2.0, 0.5, 1.0]), "orthonormal"),
        (np.full((3, 3), np.nan), "finite"),
        (np.diag([1e300, 1e300, 1e300]), "orthonormal"),
        (np.array([[1e300, -1e300, 0], [1e300, 1e300, 0], [0, 0, 1e-300]]), "orthonormal"),
    ],
)
def test_rotation_fault(matrix: F64, fault: str | None) -> None:
    found = rotation_fault(matrix)
    assert found is None if fault is None else fault in (found or "")
