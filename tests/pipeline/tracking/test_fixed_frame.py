from dataclasses import replace

import numpy as np
import pytest
from frames import RIG, frame
from lidar_scene import combined, rig

from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Fused, Source
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.tracking.fixed_frame import NO_TRACK_REASON, SightingsOf, with_tracks
from lidcam.pipeline.tracking.motion import HEADING, SPEED, TURN, Motions, Priors, at_centers, at_rear_axles, predicted
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.sightings import NOT_SEEN, FrameSightings, TrackRows
from lidcam.pipeline.tracking.trackers import object_tracker

CONFIG = load_config()
CLASSES = len(CONFIG.classes)


def result(*, moving: bool = False, count: int = 3) -> FrameResult:
    """A frame; on a moving rig, that stands turned by 90 degrees at (10, 2, 1)."""
    made = frame(objects=count)
    if not moving:
        return made
    stamp_ns = made.bundle.stamp_ns
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    poses[:, :3, 3] = [[9.0, 2.0, 1.0], [11.0, 2.0, 1.0]]
    motion = PoseSamples("site", "odom", np.array([stamp_ns - 10**8, stamp_ns + 10**8]), poses)
    return replace(made, bundle=replace(made.bundle, motion=motion))


def rows_of(seen: FrameSightings) -> TrackRows:
    """A track at each sighting that is reported."""
    tracker = OnlineTracker(Priors.of_classes(CONFIG.classes), min_existence=0.0, max_gap_s=1.0)
    rows = tracker.add_frame(seen)[0]
    rows.states[:, SPEED] = 3.0
    return replace(rows, covariances=np.tile(np.eye(5), (len(rows), 1, 1)))


def tracked(one: FrameResult, rows: TrackRows | None = None, zones: tuple[Zone, ...] = ()) -> Fused:
    seen = SightingsOf(RIG, CLASSES)(one)
    return with_tracks(one.fused, seen, rows_of(seen) if rows is None else rows, zones)


@pytest.mark.parametrize(
    ("recorded", "expected"),
    [
        ([True] * 4, [10.0] * 4),
        ([False] * 4, [0.0] * 4),
        ([False, False, True, True], [0.0] * 4),
        ([True, True, False, True], [10.0] * 4),
    ],
    ids=["always", "never", "late", "gap"],
)
def test_the_fixed_frame_stays(recorded: list[bool], expected: list[float]) -> None:
    """Of a rig that stands, at (10, 2, 1) in the recorded frame."""
    sightings_of = SightingsOf(RIG, CLASSES)
    found = [sightings_of(result(moving=moving)).T_fixed_site[0, 3] for moving in recorded]
    assert found == pytest.approx(expected)


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("count", [0, 1, 3])
def test_boxes_go_to_the_fixed_frame_and_back(moving: bool, count: int) -> None:
    one = result(moving=moving, count=count)
    found = tracked(one)
    before = one.fused.objects
    np.testing.assert_allclose(found.objects.centers, before.centers, atol=1e-9)
    np.testing.assert_allclose(np.cos(found.objects.yaws - before.yaws), 1.0)
    assert found.rows.tolist() == one.fused.rows.tolist()
    assert found.tracks is not None
    assert found.tracks.ids.tolist() == list(range(1, count + 1))


def test_places_are_those_over_the_ground() -> None:
    one = result(moving=True)
    seen = SightingsOf(RIG, CLASSES)(one)
    x, y, z = one.fused.objects.centers.T
    np.testing.assert_allclose(seen.sightings.boxes[:, :2], np.column_stack([10 - y, 2 + x]), atol=1e-9)
    np.testing.assert_allclose(seen.sightings.heights_m, z + 1)


def test_velocities_are_along_the_axes_of_the_site() -> None:
    one = result(moving=True)
    found = tracked(one)
    assert found.tracks is not None
    yaws = found.objects.yaws
    np.testing.assert_allclose(found.tracks.velocities, 3.0 * np.column_stack([np.cos(yaws), np.sin(yaws)]), atol=1e-9)
    # Of heading and speed, both of variance 1: along the heading that of the speed, across it speed^2.
    spread = np.linalg.eigvalsh(found.tracks.velocity_covariances)
    np.testing.assert_allclose(spread, np.tile([1.0, 9.0], (len(yaws), 1)))


def test_velocities_are_those_of_the_centres() -> None:
    """A car of 3 m/s that turns by 0.5 rad/s about its rear axle, 1 m behind its centre."""
    one = result()
    rows = rows_of(SightingsOf(RIG, CLASSES)(one))
    rows.states[:, TURN], rows.rear_m[:] = 0.5, 1.0
    found = tracked(one, rows).tracks
    assert found is not None
    after, _ = predicted(at_rear_axles(Motions(rows.states, rows.covariances), rows.rear_m), 1e-6, np.zeros((3, 5)))
    moved_m = at_centers(after, rows.rear_m).states[:, :2] - rows.states[:, :2]
    np.testing.assert_allclose(found.velocities, moved_m / 1e-6, atol=1e-4)
    # Of heading, speed and yaw rate, all of variance 1.
    np.testing.assert_allclose(np.trace(found.velocity_covariances, axis1=1, axis2=2), 3.0**2 + 0.5**2 + 1.0 + 1.0)


def test_what_is_not_seen_is_predicted() -> None:
    one = result()
    rows = rows_of(SightingsOf(RIG, CLASSES)(one))
    found = tracked(one, replace(rows, seen=np.where(rows.ids == 2, NOT_SEEN, rows.seen)))
    assert found.rows[1] == NO_HYPOTHESIS
    assert found.objects.sources[1] == Source.PREDICTED
    assert (found.matched[1], found.objects.point_counts[1]) == (0, 0)
    assert found.left_out == {NO_TRACK_REASON: 1}


def test_what_has_no_track_is_counted() -> None:
    one = result()
    found = tracked(one, TrackRows.none())
    assert len(found.objects) == 0
    assert found.left_out == {NO_TRACK_REASON: 3}


def test_objects_of_no_class_stand_behind_without_a_number() -> None:
    one = result()
    class_ids = one.fused.objects.class_ids.copy()
    class_ids[0] = CLASSES
    one = replace(one, fused=replace(one.fused, objects=replace(one.fused.objects, class_ids=class_ids)))
    found = tracked(one)
    assert found.tracks is not None
    assert found.tracks.ids.tolist() == [1, 2, 0]
    assert found.objects.class_ids[-1] == CLASSES
    assert not found.left_out


def test_headings_stay_within_half_a_turn() -> None:
    one = result(moving=True)
    rows = rows_of(SightingsOf(RIG, CLASSES)(one))
    rows.states[:, HEADING] += 2 * np.pi
    assert np.abs(tracked(one, rows).objects.yaws).max() <= np.pi


@pytest.mark.parametrize(("mode", "waits"), [("online", False), ("offline", True)])
def test_every_frame_is_given_once(mode: str, waits: bool) -> None:
    tracker = object_tracker(load_config(settings={"track.mode": mode}), RIG)
    assert tracker is not None
    given = [len(tracker.add_frame(frame(index))) for index in range(4)]
    assert given == ([0] * 4 if waits else [1] * 4)
    left = tracker.finish()
    assert len(left) == (4 if waits else 0)
    assert all(fused.tracks is not None for fused in left)


@pytest.mark.parametrize("all_speeds", [False, True])
def test_speeds_of_too_few_measurements_are_not_said(all_speeds: bool) -> None:
    tracker = object_tracker(load_config(settings={"track.mode": "online"}), RIG, all_speeds=all_speeds)
    assert tracker is not None
    said = [tracker.add_frame(frame(index))[0].tracks for index in range(3)]
    assert [tracks is not None and bool(np.isnan(tracks.speeds).any()) for tracks in said] == (
        [not all_speeds, not all_speeds, False]
    )


@pytest.mark.parametrize("shown", [False, True])
def test_lidars_show_fronts_and_cameras_do_not(shown: bool) -> None:
    one = result()
    one = replace(one, hypotheses=replace(one.hypotheses, lidar_count=2))
    seen = SightingsOf(RIG, CLASSES, lidars_show_front=shown)(one)
    assert seen.sightings.show_front.tolist() == [shown, shown, False]


@pytest.mark.parametrize(
    ("points", "side"),
    [((9, 0), -1.0), ((0, 9), 1.0), ((9, 9), 0.0), ((0, 0), 0.0)],
    ids=["rear", "front", "both", "none"],
)
def test_the_side_that_is_seen_is_that_of_the_lidars_whose_points_it_has(points: tuple[int, int], side: float) -> None:
    one = result(count=1)
    at = one.hypotheses.boxes.centers[0]
    ahead = 20 * np.array([np.cos(one.hypotheses.boxes.yaws[0]), np.sin(one.hypotheses.boxes.yaws[0])])
    lidars = rig((*(at[:2] - ahead), 2.0), (*(at[:2] + ahead), 2.0))
    one = replace(one, combined=combined(*(np.tile(at, (count, 1)) for count in points)))
    assert SightingsOf(lidars, CLASSES)(one).sightings.sides[0] == pytest.approx([side, 0.0], abs=1e-6)


def test_without_tracks_there_is_no_tracker() -> None:
    assert object_tracker(load_config(settings={"track.mode": "none"}), RIG) is None
