"""numpy, field by field, is the judge."""

import numpy as np
import pytest

from pipeline.core.ros.point_kernels import packed_points

POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])


@pytest.mark.parametrize("n", [0, 1, 1000])
@pytest.mark.parametrize("later_ns", [0.0, -3e8, 1.5])
def test_points_are_those_of_numpy(n: int, later_ns: float) -> None:
    rng = np.random.default_rng(n)
    points = np.zeros(n, POINT)
    points["xyz"], points["intensity"] = rng.normal(0, 50, (n, 3)), rng.random(n)
    points["ring"], offsets_ns = rng.integers(0, 2**16, n), rng.integers(-(2**31), 2**31, n).astype(np.int32)
    points["time"] = (offsets_ns + later_ns) * 1e-9
    halves = np.ascontiguousarray(points["xyz"]).view(np.uint16).reshape(n, 6)
    intensity, ring = np.ascontiguousarray(points["intensity"]), np.ascontiguousarray(points["ring"])
    assert packed_points(halves, intensity, ring, offsets_ns, later_ns).tobytes() == points.tobytes()
