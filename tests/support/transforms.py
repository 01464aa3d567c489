"""Transforms for tests: any, by hypothesis, and plain shifts along x."""

import numpy as np
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.transform import Transform

metres = st.floats(-1e3, 1e3)
vectors = st.tuples(metres, metres, metres)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-2)


@st.composite
def transforms(draw: st.DrawFn, dst: str = "b", src: str = "a") -> Transform:
    """Any transform between two named frames."""
    return Transform.from_quaternion(dst, src, draw(vectors), draw(quaternions))


def shift(dst: str, src: str, x: float) -> Transform:
    """A shift along x."""
    return Transform.from_quaternion(dst, src, [x, 0, 0], [0, 0, 0, 1])
