from dataclasses import replace

import numpy as np
from detections import boxes3d
from frames import CONFIG, PERIOD_NS, START_NS, frame, tracks_of

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


def test_a_trail_is_where_its_track_was_on_the_ground() -> None:
    found = last_trails(at(0, {3: (1, 2), 5: (7, 7)}), at(1, {5: (8, 7), 9: (0, 0), 3: (1, 3)}))
    assert found == [[[7, 7, 0], [8, 7, 0]], [], [[1, 2, 0], [1, 3, 0]]]


def test_objects_without_a_track_have_none() -> None:
    assert last_trails(at(0, {0: (1, 2)}), at(1, {0: (1, 3)})) == [[]]
    assert last_trails(frame(0), frame(1)) == [[], [], []]


def test_a_trail_ends_after_its_time_and_nothing_older_is_kept() -> None:
    trails = Trails("site", CONFIG.combine.motion)
    lengths = [len(trails.add_frame(at(index, {1: (index, 0)}))[0]) for index in range(2 * FRAMES_OF_TRAIL)]
    assert lengths[:3] == [0, 2, 3]
    assert max(lengths) == lengths[-1] == FRAMES_OF_TRAIL
    (trail,) = trails.add_frame(at(10 * FRAMES_OF_TRAIL, {1: (0, 0)}))
    assert len(trail) == 0


def test_a_track_that_comes_back_has_its_trail() -> None:
    assert last_trails(at(0, {1: (0, 0)}), at(1, {}), at(2, {1: (2, 0)})) == [[[0, 0, 0], [2, 0, 0]]]


def test_time_that_jumps_back_begins_anew() -> None:
    assert last_trails(at(5, {1: (0, 0)}), at(1, {1: (2, 0)})) == [[]]


def test_the_past_is_carried_along_with_a_rig_that_moves() -> None:
    then, now = np.eye(4), np.eye(4)
    now[:2, :2], now[:2, 3] = [[0.0, -1.0], [1.0, 0.0]], [10.0, 0.0]  # 10 m ahead, then a quarter turn to the left
    still = np.stack([then, then])
    (trail,) = last_trails(at(0, {1: (10, 5)}, still), at(1, {1: (5, 0)}, np.stack([then, now])))
    np.testing.assert_allclose(trail, [[5, 0, 0], [5, 0, 0]], atol=1e-9)


def test_where_the_motion_is_not_known_trails_begin_anew() -> None:
    poses = np.stack([np.eye(4)] * 2)
    first, second = at(0, {1: (0, 0)}, poses), at(30, {1: (1, 0)}, poses)
    assert second.bundle.stamp_ns == START_NS + 30 * PERIOD_NS
    assert last_trails(first, second) == [[]]
