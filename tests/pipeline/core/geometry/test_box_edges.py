import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.box_edges import clip_segments, edges_ahead, sample_by_angle
from lidcam.pipeline.core.geometry.boxes import box_corners

WIDTH, HEIGHT = 640.0, 480.0
coordinates = st.floats(-2000, 2000).map(lambda value: round(value, 3)) | st.sampled_from([0.0, WIDTH, HEIGHT])
ends = st.tuples(coordinates, coordinates)


@given(st.lists(st.tuples(ends, ends), max_size=5))
def test_clipped_segments_are_the_parts_inside(rows: list[tuple[tuple[float, float], tuple[float, float]]]) -> None:
    segments = np.array(rows, np.float64).reshape(-1, 2, 2)
    clipped, inside = clip_segments(segments, np.array([WIDTH, HEIGHT]))
    limit = np.array([WIDTH, HEIGHT])
    shares = np.linspace(0, 1, 501)[:, None]
    for segment, part, kept in zip(segments, clipped, inside, strict=True):
        samples = segment[0] * (1 - shares) + segment[1] * shares
        is_in = ((samples > 1e-6) & (samples < limit - 1e-6)).all(1)
        length = float(np.linalg.norm(segment[1] - segment[0]))
        if not kept:
            assert not is_in.any() or length == 0
            continue
        assert ((part >= 0) & (part <= limit)).all()
        along = (part - segment[0]) @ (segment[1] - segment[0]) / length**2
        at = segment[0] + along[:, None] * (segment[1] - segment[0])
        np.testing.assert_allclose(part, at, atol=1e-6 * (1 + length))  # on the segment
        assert np.all((shares[is_in, 0] >= along[0] - 1e-6) & (shares[is_in, 0] <= along[1] + 1e-6))


@given(
    st.tuples(*[st.floats(-20, 20)] * 2, st.floats(0.1, 30)), st.tuples(*[st.floats(-20, 20)] * 2, st.floats(0.1, 30))
)
def test_samples_are_evenly_spaced_as_seen_from_the_origin(
    start: tuple[float, float, float], end: tuple[float, float, float]
) -> None:
    first, last = np.array(start), np.array(end)
    samples = sample_by_angle(first, last, 9)
    np.testing.assert_allclose(samples[[0, -1]], [first, last], atol=1e-9)
    length = float(np.linalg.norm(last - first))
    beside = np.linalg.norm(np.cross(samples - first, last - first), axis=1)
    np.testing.assert_allclose(beside, 0, atol=1e-6 * (1 + length**2))
    rays = samples / np.linalg.norm(samples, axis=1, keepdims=True)
    angles = 2 * np.arcsin(np.clip(np.linalg.norm(np.diff(rays, axis=0), axis=1) / 2, 0, 1))
    np.testing.assert_allclose(angles, angles.mean(), atol=1e-6)


@pytest.mark.parametrize(("z", "left", "nearest"), [(5.0, 12, 4.0), (-5.0, 0, np.inf), (0.0, 8, 0.1)])
def test_what_of_a_box_is_behind_is_cut(z: float, left: int, nearest: float) -> None:
    corners = box_corners(np.array([[0.0, 0, z]]), np.array([[2.0, 2, 2]]), np.zeros(1))
    start, end, kept = edges_ahead(corners, 0.1)
    assert kept.sum() == left
    assert np.minimum(start[kept][:, 2], end[kept][:, 2]).min(initial=np.inf) == pytest.approx(nearest)
