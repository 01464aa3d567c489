import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.readers.rig.calibration import rigid_transform
from lidcam.readers.rig.lens import decompose_projection


@given(
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-50, 50)] * 3),
    st.floats(100, 3000),
    st.floats(100, 3000),
    st.floats(1e-3, 1e3),
)
def test_a_projection_comes_apart_into_what_it_was_made_of(
    turn: tuple[float, ...], shift: tuple[float, ...], fx: float, fy: float, scale: float
) -> None:
    K = np.array([[fx, 0.5, 640], [0, fy, 360], [0, 0, 1]])
    Rt = np.c_[Rotation.from_rotvec(turn).as_matrix(), shift]
    found_K, matrix = decompose_projection("P", scale * K @ Rt)
    np.testing.assert_allclose(found_K, K, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(matrix[:3], Rt, atol=1e-6)
    rigid_transform("pose", "camera", "site", matrix)
