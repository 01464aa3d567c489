from dataclasses import replace

import numpy as np
import pytest

from lidcam.pipeline.core.detections import Boxes3D, Fused
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks


@pytest.mark.parametrize("count", [0, 1, 3])
def test_nothing_is_known_of_objects_without_tracks(count: int) -> None:
    tracks = Tracks.none(count)
    assert len(tracks) == count
    assert len(tracks.select(np.arange(count)[:1])) == min(count, 1)
    assert (tracks.ids == NO_TRACK).all()
    assert not tracks.fronts_known.any()
    assert tracks.speeds.tolist() == [0.0] * count


def test_speeds_are_those_over_the_ground_where_the_motion_is_known() -> None:
    tracks = replace(Tracks.none(2), velocities=np.array([[3.0, -4.0], [0.0, 1.0]]), yaw_rates=np.ones(2))
    assert tracks.speeds.tolist() == [5.0, 1.0]
    tracks = tracks.without_motion(np.array([False, True]))
    np.testing.assert_array_equal(tracks.speeds, [5.0, np.nan])
    np.testing.assert_array_equal(tracks.motions, [[3, -4, 1], [np.nan] * 3])
    assert tracks.velocities[1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("velocity", "sigmas", "moving"),
    [
        ((0.29, 0.0), (0.01, 0.01), False),
        ((0.3, 0.0), (0.01, 0.01), True),
        ((11.6, 0.0), (5.45, 0.1), False),  # seen in three frames
        ((0.0, 1.3), (5.45, 0.4), True),  # the deviation along the motion counts
        ((3.0, 4.0), (1.7, 1.7), False),
        ((3.0, 4.0), (1.6, 1.6), True),
    ],
)
def test_what_moves_does_so_beyond_its_uncertainty(
    velocity: tuple[float, float], sigmas: tuple[float, float], moving: bool
) -> None:
    covariances = np.diag(np.square(sigmas))[None].repeat(2, 0)
    tracks = replace(Tracks.none(2), velocities=np.array([velocity] * 2), velocity_covariances=covariances)
    assert tracks.without_motion(np.array([False, True])).moving.tolist() == [moving, False]


def test_each_object_has_one_track() -> None:
    nothing = Boxes3D.empty(0, "site")
    with pytest.raises(ValueError, match="tracks: expected 0"):
        Fused(nothing, np.zeros(0, np.int32), np.zeros(0, np.int64), tracks=Tracks.none(1))
