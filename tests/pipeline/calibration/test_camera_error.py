"""An error of a camera that is put in is found, within the confidence that is stated; too little says nothing."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_cameras import CAMERA, cuboids, passing, without_tracks

from lidcam.pipeline.calibration.camera_error import MIN_PAIRS, CameraError, camera_error
from lidcam.pipeline.calibration.pairs import tracked_pairs
from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.fuse import FuseConfig

LIDAR_XYZ = np.zeros((1, 3))
DEGREE = np.pi / 180


@pytest.fixture(autouse=True, scope="module")
def _objects_are_cuboids() -> Iterator[None]:
    with patch("lidcam.pipeline.calibration.camera_error.rounded_outline", cuboids):
        yield


def judged(frames: Sequence[FrameResult]) -> CameraError | None:
    found = [pairs for frame in frames for _, pairs in tracked_pairs(frame)]
    return camera_error(join_rows(*found), CAMERA, LIDAR_XYZ, FuseConfig()) if found else None


@pytest.mark.parametrize("speed_m_s", [0.0, 8.0], ids=["standing", "driving"])
@pytest.mark.parametrize(
    "values", [(0, 0, 0, 0, 0, 0, 0), (0.01, -0.02, 0.01, 0.1, -0.1, 0.1, -0.04)], ids=["none", "all"]
)
def test_without_noise_the_error_is_found_as_it_is(values: tuple[float, ...], speed_m_s: float) -> None:
    found = judged(passing(values, noise=0.0, frames=25, speed_m_s=speed_m_s))
    assert found is not None
    # The prior draws a little towards none.
    assert np.abs(found.values - values)[:3].max() < 0.06 * DEGREE
    assert np.abs(found.values - values)[3:6].max() < 0.03
    assert abs(found.values[6] - values[6]) < 1e-3


@settings(max_examples=10, deadline=None)
@given(
    st.tuples(*[st.floats(-0.03, 0.03)] * 3, *[st.floats(-0.1, 0.1)] * 3, st.floats(-0.08, 0.08)),
    st.integers(0, 2**31),
    st.sampled_from([0.0, 6.0]),
)
def test_with_noise_it_is_within_the_confidence(values: tuple[float, ...], seed: int, speed_m_s: float) -> None:
    found = judged(passing(values, seed=seed, tracks=12, speed_m_s=speed_m_s))
    assert found is None or (np.abs(found.values - values) < 4.5 * found.sigmas).all()


def test_a_parked_car_that_is_seen_for_long_is_one_witness() -> None:
    [once] = [pairs for _, pairs in tracked_pairs(passing(tracks=40, frames=1, seed=4)[0])]
    later = (replace(once, stamps_ns=once.stamps_ns + number * 10**9) for number in range(30))
    found = [camera_error(pairs, CAMERA, LIDAR_XYZ, FuseConfig()) for pairs in (once, join_rows(*later))]
    assert found[0] is not None
    assert found[1] is not None
    assert (found[1].sigmas > 0.9 * found[0].sigmas).all()


def test_wrong_matches_do_little_harm() -> None:
    frames = passing((0, DEGREE, 0, 0, 0, 0, 0), seed=3)
    for result in frames[::5]:
        boxes = result.detections.cameras["cam"]
        boxes.xyxy.flags.writeable = True
        boxes.xyxy[:1] += 60
    found = judged(frames)
    assert found is not None
    assert abs(found.values[1] - DEGREE) < 0.25 * DEGREE


def test_objects_that_the_border_cuts_are_left_out_though_their_boxes_end_short_of_it() -> None:
    model = CAMERA.model
    camera = replace(CAMERA, model=replace(model, width_px=model.width_px * 5 // 8))
    frames = passing(seed=3, tracks=12, camera=camera)
    for result in frames:
        boxes = result.detections.cameras["cam"]
        boxes.xyxy.flags.writeable = True
        boxes.xyxy[:, 2] = boxes.xyxy[:, 2].clip(max=camera.model.width_px - 8)
    pairs = join_rows(*(pairs for frame in frames for _, pairs in tracked_pairs(frame)))
    found = camera_error(pairs, camera, LIDAR_XYZ, FuseConfig())
    assert found is not None
    assert found.pairs < len(pairs)
    assert (np.abs(found.values) < 3 * found.sigmas).all()


def test_noise_of_the_sides_is_learned_beside_that_of_top_and_bottom() -> None:
    frames, random = passing(seed=2, tracks=12), np.random.default_rng(5)
    for result in frames:
        boxes = result.detections.cameras["cam"]
        boxes.xyxy.flags.writeable = True
        boxes.xyxy[:, ::2] += random.normal(0, 8, (len(boxes), 2)).astype(np.float32)
    found = judged(frames)
    assert found is not None
    (side_px, side_share), (upright_px, upright_share) = found.noise
    at_60_px = np.hypot([side_px, upright_px], 60 * np.array([side_share, upright_share]))
    assert 6 < at_60_px[0] < 11
    assert at_60_px[1] < 4


@pytest.mark.parametrize(
    "frames",
    [[], without_tracks(passing(frames=3)), passing(frames=3), passing(tracks=1, frames=90), passing(tracks=2, seed=3)],
    ids=["nothing", "no tracks", "few pairs", "one track", "two tracks, each from one side"],
)
def test_too_little_is_not_judged(frames: list[FrameResult]) -> None:
    assert judged(frames) is None


def test_what_was_used_is_counted() -> None:
    frames = passing(seed=1)
    found = judged(frames)
    assert found is not None
    assert MIN_PAIRS <= found.pairs <= sum(len(pairs) for frame in frames for _, pairs in tracked_pairs(frame))
    assert 2 <= found.tracks <= 8
    assert found.size_m == pytest.approx(np.sqrt(4.4 * 1.8))
