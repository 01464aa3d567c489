from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d
from frames import CONFIG, PERIOD_NS, frame, tracks_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.writers.trails import TRAIL_S, Trails

FRAMES_OF_TRAIL = round(TRAIL_S * 1e9 / PERIOD_NS) + 1


def at(index: int, places: dict[int, tuple[float, float]], poses: F64 | None = None) -> FrameResult:
    """A frame with cubes of 2 m on the ground, by track; poses (2, 4, 4) of the site 0.1 s before and at its stamp."""
    result = frame(index, objects=0)
    boxes = boxes3d([(x, y, 1.0, 2, 2, 2, 0) for x, y in places.values()])
    fused = replace(
        result.fused,
        objects=replace(boxes, stamp_ns=result.bundle.stamp_ns),
        matched=np.zeros(len(places), np.int32),
        rows=np.arange(len(places)),
        tracks=tracks_of([*places]),
    )
    stamps_ns = np.array([-PERIOD_NS, 0]) + result.bundle.stamp_ns
    motion = None if poses is None else PoseSamples("site", "odom", stamps_ns, poses)
    return replace(result, fused=fused, bundle=replace(result.bundle, motion=motion))


def last_trails(*results: FrameResult) -> list[list[list[float]]]:
    trails = Trails("site", CONFIG.combine.motion)
    return [[trail.tolist() for trail in trails.add_frame(result)] for result in results][-1]


STILL = np.stack([np.eye(4)] * 2)
CASES = {
    "on the ground": (
        [at(0, {3: (1, 2), 5: (7, 7)}), at(1, {5: (8, 7), 9: (0, 0), 3: (1, 3)})],
        [[[7, 7, 0], [8, 7, 0]], [], [[1, 2, 0], [1, 3, 0]]],
    ),
    "without a track": ([at(0, {0: (1, 2)}), at(1, {0: (1, 3)})], [[]]),
    "without tracks": ([frame(0), frame(1)], [[], [], []]),
    "comes back": ([at(0, {1: (0, 0)}), at(1, {}), at(2, {1: (2, 0)})], [[[0, 0, 0], [2, 0, 0]]]),
    "time jumps back": ([at(5, {1: (0, 0)}), at(1, {1: (2, 0)})], [[]]),
    "motion not known": ([at(0, {1: (0, 0)}, STILL), at(30, {1: (1, 0)}, STILL)], [[]]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_trail_is_where_its_track_was(case: str) -> None:
    frames, expected = CASES[case]
    assert last_trails(*frames) == expected


def test_a_trail_ends_after_its_time_and_nothing_older_is_kept() -> None:
    trails = Trails("site", CONFIG.combine.motion)
    lengths = [len(trails.add_frame(at(index, {1: (index, 0)}))[0]) for index in range(2 * FRAMES_OF_TRAIL)]
    assert lengths[:3] == [0, 2, 3]
    assert max(lengths) == lengths[-1] == FRAMES_OF_TRAIL
    (trail,) = trails.add_frame(at(10 * FRAMES_OF_TRAIL, {1: (0, 0)}))
    assert len(trail) == 0


def test_the_past_is_carried_along_with_a_rig_that_moves() -> None:
    now = np.eye(4)
    now[:2, :2], now[:2, 3] = [[0.0, -1.0], [1.0, 0.0]], [10.0, 0.0]  # 10 m ahead, then a quarter turn to the left
    (trail,) = last_trails(at(0, {1: (10, 5)}, STILL), at(1, {1: (5, 0)}, np.stack([np.eye(4), now])))
    np.testing.assert_allclose(trail, [[5, 0, 0], [5, 0, 0]], atol=1e-9)
