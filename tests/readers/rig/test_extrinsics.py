import json

import numpy as np
import pytest
from helpers import shared
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.camera import CameraModel
from lidcam.readers.rig.extrinsics import decompose_projection, rigid_transform


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


@pytest.mark.parametrize("name", ["s110_camera_basler_south1_8mm", "s110_camera_basler_south2_8mm"])
def test_projections_of_a_real_gantry(name: str) -> None:
    file = json.loads(shared(f"data/roadside/tumtraf_calib/{name}.json").read_text())
    P = np.array(file["projection_from_s110_lidar_ouster_south"])
    K, matrix = decompose_projection("P", P)
    T_camera_lidar = rigid_transform("P's pose", "camera", "lidar", matrix)
    model = CameraModel("camera", file["image_width"], file["image_height"], K, "plumb_bob", np.zeros(0))
    ahead = T_camera_lidar.inverse().apply(np.array([[0.0, 0, 20], [5, 2, 40], [-8, -1, 25]]))
    pixels, valid = model.project(T_camera_lidar.apply(ahead))
    judge = np.c_[ahead, np.ones(3)] @ P.T
    assert valid.all()
    np.testing.assert_allclose(pixels - 0.5, judge[:, :2] / judge[:, 2:], atol=0.01)
