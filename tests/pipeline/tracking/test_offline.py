from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import at_most
from tracked_scenes import (
    BICYCLE,
    BUS,
    CAR,
    PEDESTRIAN,
    PERIOD_S,
    PRIORS,
    START_NS,
    TRUCK,
    Mover,
    circling,
    scene,
    straight,
)

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.tracking.motion import HEADING, REAR_SHARE, SPEED
from lidcam.pipeline.tracking.offline import OfflineTracker
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.sightings import NOT_SEEN, FrameSightings, TrackRows

CARS = [Mover(straight(-30, 0, 0, 8.0)), Mover(straight(30, 4, np.pi, 6.0)), Mover(straight(5, -8, 1.0, 0.0))]


def tracked(frames: list[FrameSightings], window_s: float = 60.0) -> list[TrackRows]:
    tracker = OfflineTracker(PRIORS, min_existence=0.5, window_s=window_s, max_gap_s=3.0)
    return [rows for frame in frames for rows in tracker.add_frame(frame)] + tracker.finish()


def ids(rows: list[TrackRows]) -> list[list[int]]:
    return [row.ids.tolist() for row in rows]


@pytest.mark.parametrize("frames", [0, 1, 5])
def test_of_nothing_there_are_no_tracks(frames: int) -> None:
    assert ids(tracked(scene([], frames))) == [[]] * frames


@pytest.mark.parametrize("frames", [1, 2, 40])
def test_each_car_has_one_number_from_its_first_sighting_on(frames: int) -> None:
    assert ids(tracked(scene(CARS, frames))) == [[1, 2, 3]] * frames


@pytest.mark.parametrize(("frames", "known"), [(2, False), (3, True)])
@pytest.mark.parametrize("online", [False, True])
def test_a_speed_needs_three_measurements(frames: int, known: bool, online: bool) -> None:
    tracker = OnlineTracker(PRIORS, min_existence=0.0, max_gap_s=3.0)
    seen = scene(CARS, frames)
    rows = [one for frame in seen for one in tracker.add_frame(frame)] if online else tracked(seen)
    assert rows[-1].speeds_known.tolist() == [known] * 3


@pytest.mark.parametrize("make", [OnlineTracker, partial(OfflineTracker, window_s=60.0)])
def test_a_speed_that_the_class_cannot_have_is_not_known(make: Any) -> None:
    slow = replace(PRIORS, scales_m=PRIORS.scales_m * 7 / PRIORS.max_speeds[CAR])
    tracker = make(slow, min_existence=0.5, max_gap_s=3.0)
    rows = [one for frame in scene(CARS, 12) for one in tracker.add_frame(frame)] + tracker.finish()
    assert np.abs(rows[-1].states[:, SPEED]).round().tolist() == [8, 6, 0]
    assert rows[-1].speeds_known.tolist() == [False, True, True]


def test_frames_that_are_far_apart_have_their_objects() -> None:
    frames = [replace(one, stamp_ns=one.stamp_ns + k * 10**10) for k, one in enumerate(scene(CARS, 5))]
    assert ids(tracked(frames)) == [[3 * k + 1, 3 * k + 2, 3 * k + 3] for k in range(5)]


@pytest.mark.parametrize(
    ("frames", "every", "count"), [([7], 1, 0), ([7, 8], 1, 0), (range(7, 12), 1, 5), ([10], 5, 0), ([10], 10, 1)]
)
def test_what_is_seen_for_a_moment_only_is_left_out(frames: Sequence[int], every: int, count: int) -> None:
    """A second later, it may be gone."""
    rows = tracked(scene([Mover(straight(0, 0, 0, 0), belief=0.9, seen=lambda k: k in frames)], 20)[::every])
    assert sum(map(len, rows)) == count


def test_the_smoothed_track_is_nearer_than_what_was_seen() -> None:
    frames = scene(CARS, 60, noise_m=0.3)
    rows = tracked(frames)
    truth = np.array([[mover.place(k * PERIOD_S)[:2] for mover in CARS] for k in range(60)])
    found = np.array([row.states[:, :2] for row in rows])
    seen = np.array([one.sightings.boxes[:, :2] for one in frames])
    assert np.linalg.norm(found - truth, axis=-1).mean() < 0.5 * np.linalg.norm(seen - truth, axis=-1).mean()


def test_a_tight_curve_has_the_heading_of_the_vehicle_not_that_of_its_centre() -> None:
    place = circling(6.0, 4.0, REAR_SHARE * 4.0)
    rows = tracked(scene([Mover(place)], 60))
    errors = [row.states[0, HEADING] - place(k * PERIOD_S)[2] for k, row in enumerate(rows)]
    turned = np.abs((np.array(errors) + np.pi) % (2 * np.pi) - np.pi)
    assert np.degrees(turned[5:-5]).max() < 2.0


def test_the_front_is_where_it_goes_from_the_first_frame_on() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0.3, 5.0), turned=lambda k: k % 4 != 3)], 40))
    assert all(abs(row.states[0, HEADING] - 0.3) < 0.1 for row in rows)
    assert all(row.fronts_known.all() for row in rows)
    assert all(row.states[0, SPEED] > 0 for row in rows)


@pytest.mark.parametrize(("seconds", "front"), [(4, 0.3), (20, 0.3 - np.pi)])
def test_a_car_that_reverses_a_little_keeps_the_front_that_all_boxes_show(seconds: int, front: float) -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0.3, -2.0))], 10 * seconds))
    assert all(abs(row.states[0, HEADING] - front) < 0.1 for row in rows)


def test_what_stands_has_one_pose_and_no_front() -> None:
    rows = tracked(scene(CARS[2:], 40, noise_m=0.1))
    places = np.array([row.states[0, :3] for row in rows])
    assert np.ptp(places, axis=0).max() < 0.01
    assert not any(row.fronts_known.any() for row in rows)


def test_a_gap_is_filled_and_marked() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 8.0), belief=0.7, seen=lambda k: not 15 <= k < 40)], 60))
    assert ids(rows) == [[1]] * 60
    assert [row.seen[0] == NOT_SEEN for row in rows] == [15 <= k < 40 for k in range(60)]
    assert rows[27].states[0, 0] == pytest.approx(8.0 * 27 * PERIOD_S, abs=0.5)
    assert rows[27].covariances[0, 0, 0] > 2 * rows[5].covariances[0, 0, 0]


def test_a_longer_gap_begins_another_track() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 8.0), seen=lambda k: not 15 <= k < 50)], 70))
    assert (ids(rows)[0], ids(rows)[30], ids(rows)[-1]) == ([1], [], [2])


def test_a_row_of_cars_keeps_its_numbers_over_a_gap_in_the_recording_in_which_it_stops() -> None:
    def stopping(at_x: float) -> Mover:
        return Mover(lambda t: (at_x + 5.0 * min(t - 0.8, 0.0), 0.0, 0.0))

    cars = [stopping(x) for x in (0.0, 7.5, 15.0, 22.5)]
    frames = scene(cars, 43)
    rows = tracked(frames[:8] + frames[28:])
    assert ids(rows) == [[1, 2, 3, 4]] * 23
    np.testing.assert_allclose(rows[-1].states[:, 0], [0.0, 7.5, 15.0, 22.5], atol=0.2)


def test_two_classes_in_one_place_are_one_object() -> None:
    big = straight(0, 0, 0, 0.5)
    flickering = [
        Mover(big, TRUCK, (9.0, 2.5, 3.0), seen=lambda k: k % 2 == 0),
        Mover(big, BUS, (11.0, 2.5, 3.0), seen=lambda k: k % 2 == 1),
        Mover(big, CAR, (5.0, 2.0, 2.0), belief=0.6, seen=lambda k: k % 8 == 0),
    ]
    rows = tracked(scene(flickering, 40))
    assert ids(rows) == [[1]] * 40
    assert len({int(row.class_ids[0]) for row in rows}) == 1
    assert len({tuple(row.sizes[0]) for row in rows}) == 1


def test_a_part_does_not_displace_what_is_seen_whole_in_other_frames() -> None:
    lorry = Mover(straight(0, 0, 0, 8.0), TRUCK, (9.0, 2.5, 3.0), seen=lambda k: k < 6 or k % 5 > 0)
    rear = Mover(straight(-2.5, 0, 0, 8.0), CAR, (4.0, 1.8, 1.5), belief=0.7, seen=lambda k: k >= 6)
    rows = tracked(scene([lorry, rear], 40))
    assert ids(rows) == [[1]] * 40
    assert max(abs(row.states[0, 0] - 8.0 * PERIOD_S * k) for k, row in enumerate(rows)) < 0.1


@pytest.mark.parametrize("make", [OnlineTracker, partial(OfflineTracker, window_s=60.0)])
def test_a_part_that_is_seen_instead_of_the_whole_neither_moves_nor_shortens_it(make: Any) -> None:
    lorry = Mover(straight(0, 0, 0, 0), TRUCK, (6.0, 2.3, 2.2), seen=lambda k: k not in (10, 11))
    front = Mover(straight(1.2, 0, 0, 0), CAR, (3.7, 1.7, 1.7), seen=lambda k: k in (10, 11))
    frames = scene([lorry, front], 15)
    for one in frames:
        one.sightings.covariances[one.sightings.class_ids == TRUCK, 0, 0] = 0.5**2  # its front was not seen
    tracker = make(PRIORS, min_existence=0.5, max_gap_s=3.0)
    rows = [one for frame in frames for one in tracker.add_frame(frame)] + tracker.finish()
    assert ids(rows) == [[1]] * 15
    assert max(abs(row.states[0, 0]) for row in rows) < 0.6
    assert {round(row.sizes[0, 0], 3) for row in rows} == {6.0}


@pytest.mark.parametrize(("belief", "every"), [(0.6, 2), (0.95, 3)])
def test_what_is_rarely_seen_is_left_out(belief: float, every: int) -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 0), belief=belief, seen=lambda k: k % every == 0)], 41))
    assert sum(map(len, rows)) == 0


@pytest.mark.parametrize(("far", "near", "is_kept"), [(0.2, 0.98, True), (0.9, 0.2, False)])
def test_the_frames_that_show_it_best_decide(far: float, near: float, is_kept: bool) -> None:
    """A van that is doubted from afar, and what is taken for one from afar."""
    frames = scene([Mover(straight(0, 0, 0, 0))], 60)
    for index, one in enumerate(frames):
        one.sightings.beliefs[:], one.sightings.point_counts[:] = (near, 800) if 40 <= index < 50 else (far, 15)
    assert len(tracked(frames)[20]) == is_kept


@pytest.mark.parametrize(
    ("class_id", "speed", "noise_m", "seconds", "is_kept"),
    [
        (PEDESTRIAN, 1.2, 0.05, 60, True),
        (PEDESTRIAN, 1.2, 0.05, 5, True),  # then stands
        (BICYCLE, 4.0, 0.1, 60, True),
        (PEDESTRIAN, 0.0, 0.05, 60, False),  # a post
        (PEDESTRIAN, 1.2, 1.0, 60, False),  # what wanders
        (PEDESTRIAN, 9.0, 0.05, 60, False),  # a part of a lorry
        (CAR, 4.0, 0.05, 60, False),
    ],
)
def test_people_who_travel_are_people(class_id: int, speed: float, noise_m: float, seconds: int, is_kept: bool) -> None:
    def place(t: float) -> tuple[float, float, float]:
        return speed * min(t, seconds), 0.0, 0.0

    frames = scene([Mover(place, class_id, belief=0.6)], 140, noise_m=noise_m)
    for index, one in enumerate(frames):
        one.sightings.beliefs[:] = 0.6 if index % 10 == 0 else 0.3
    assert ids(tracked(frames, window_s=4.0)) == [[1] if is_kept else []] * 140


@pytest.mark.parametrize("window_s", [4.0, 60.0])
def test_what_becomes_sure_was_there_before(window_s: float) -> None:
    doubted, sure = (scene([replace(one, belief=belief) for one in CARS], 120, later_s=0.04) for belief in (0.3, 0.95))
    other = scene([Mover(straight(12, 20, 0.5, 7.0), belief=0.3)], 60)  # nothing ever shows that it is there
    frames = [*doubted[:8], *sure[8:]]
    for k, more in enumerate(other, 30):
        frames[k] = replace(frames[k], sightings=join_rows(frames[k].sightings, more.sightings))
    assert ids(tracked(frames, window_s)) == [[1, 2, 3]] * 120


@pytest.mark.parametrize(("speed", "frames", "count"), [(33.0, 2, 0), (33.0, 20, 20), (8.0, 2, 2)])
def test_what_appears_for_a_moment_is_not_as_fast_as_no_other(speed: float, frames: int, count: int) -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, speed), belief=0.9, seen=lambda k: k < frames)], frames + 20))
    assert sum(map(len, rows)) == count


def test_what_is_doubted_goes_on_from_window_to_window() -> None:
    sure, doubted = (scene([Mover(straight(0, 0, 0, 0), belief=belief)], 140) for belief in (0.99, 0.45))
    assert ids(tracked(sure[:25] + doubted[25:], window_s=4.0)) == [[1]] * 140  # the last one begins at 3 s


def test_numbers_sizes_and_fronts_go_on_from_window_to_window() -> None:
    frames = scene(CARS, 140)
    rows, whole = tracked(frames, window_s=4.0), tracked(frames)
    assert ids(rows) == [[1, 2, 3]] * 140
    assert len({tuple(row.sizes.ravel()) for row in rows}) == 1
    assert all(row.fronts_known.tolist() == [True, True, False] for row in rows)
    assert rows[-1].ages_s == pytest.approx([139 * PERIOD_S] * 3)
    away = [np.abs(one.states[:, :3] - other.states[:, :3]).max() for one, other in zip(rows, whole, strict=True)]
    assert max(away) < 0.1


def test_no_number_is_skipped_for_a_track_that_begins_between_windows() -> None:
    later = Mover(straight(5, 20, 0, 3.0), seen=lambda k: k >= 60)
    assert ids(tracked(scene([*CARS, later], 140), window_s=4.0)) == [[1, 2, 3]] * 60 + [[1, 2, 3, 4]] * 80


def test_what_is_parked_keeps_its_front_where_no_box_and_no_lane_shows_it() -> None:
    """A car passes before the last window, and boxes of clusters do not tell front from rear."""
    passes = Mover(straight(15, 3.0, np.pi, 10.0), seen=lambda index: index < 30)
    frames = scene([Mover(straight(0, 0, 0.02, 0)), passes], 140)
    for one in frames:
        one.sightings.show_front[:] = False
    rows = tracked(frames, window_s=4.0)
    headings = [row.states[np.abs(row.states[:, 1]) < 1, HEADING] for row in rows]
    assert np.cos(headings).max() < -0.9


def test_frames_of_one_stamp_do_not_end_tracks() -> None:
    """A message that was recorded twice."""
    frames = scene(CARS, 40)
    rows = tracked([*frames[:21], *frames[20:]])
    assert ids(rows) == [[1, 2, 3]] * 41


def test_frames_are_given_a_window_late() -> None:
    tracker = OfflineTracker(PRIORS, min_existence=0.5, window_s=4.0, max_gap_s=3.0)
    given = [len(tracker.add_frame(frame)) for frame in scene(CARS[2:], 140)]
    waiting = np.arange(1, 141) - np.cumsum(given)
    assert waiting.max() * PERIOD_S <= 4.0 + 5.0 + PERIOD_S
    assert sum(given) + len(tracker.finish()) == 140


def test_after_a_jump_of_time_all_tracks_are_new() -> None:
    frames = scene(CARS[:1], 30)
    rows = tracked([*frames[15:], *frames[:15]])
    assert ids(rows) == [[1]] * 15 + [[2]] * 15


def test_memory_is_that_of_the_tracks_and_not_of_all_their_pairs() -> None:
    """Forty false objects a frame, each seen once."""
    places = np.random.default_rng(1).uniform(-90, 90, (15, 40, 2))
    frames = [
        replace(scene([Mover(straight(x, y, 0, 0)) for x, y in row], 1)[0], stamp_ns=START_NS + index * 10**8)
        for index, row in enumerate(places.tolist())
    ]
    with at_most(10):
        tracked(frames)
