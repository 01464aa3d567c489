from collections.abc import Callable

import numpy as np
import pytest
from tracked_scenes import BUS, CAR, PERIOD_S, PRIORS, START_NS, TRUCK, Mover, Place, scene, straight

from lidcam.pipeline.tracking.estimates import History, estimated, renumbered
from lidcam.pipeline.tracking.joining import joined_in_place
from lidcam.pipeline.tracking.motion import HEADING, TURN
from lidcam.pipeline.tracking.sightings import FrameSightings, Scene


def one_track(frames: list[FrameSightings]) -> tuple[Scene, np.ndarray]:
    whole = Scene.of(frames)
    return whole, np.zeros(len(whole.frames), np.int64)


def test_a_short_box_gets_the_length_with_the_side_that_was_seen_in_its_place() -> None:
    frames = scene([Mover(straight(0, 0, 0, 0))], 20, noise_m=0.001)
    whole, labels = one_track(frames)
    # In half of the frames only the front 2 m were seen, by a lidar ahead: their middle is 1 m further ahead.
    short = np.arange(20) % 5 < 2
    whole.sightings.sizes[short, 0] = 2.0
    whole.sightings.boxes[short, 0] += 1.0
    whole.sightings.sides[:, 0] = 1.0
    found = estimated(whole, labels, PRIORS)
    assert found.sizes[0, 0] == 4.0
    np.testing.assert_allclose(found.motions.states[:, 0], 0.0, atol=0.02)


def test_the_length_is_that_of_the_frames_that_show_both_ends() -> None:
    whole, labels = one_track(scene([Mover(straight(0, 0, 0, 0))], 40, noise_m=0.01))
    sure = np.arange(40) % 4 == 0
    whole.sightings.sizes[sure, 0] = 3.5
    whole.sightings.sides[:, 0] = 1.0
    whole.sightings.covariances[~sure, 0, 0] = 0.3**2
    assert estimated(whole, labels, PRIORS).sizes[0, 0] == 3.5


@pytest.mark.parametrize("class_id", [CAR, TRUCK])
def test_a_length_that_nobody_saw_is_as_usual_in_the_recording(class_id: int) -> None:
    movers = [Mover(straight(0, 9.0 * row, 0, 0), class_id=class_id) for row in range(9)]
    whole = Scene.of(scene(movers, 10, noise_m=0.001))
    labels, usual_m = np.tile(np.arange(9), 10), PRIORS.lengths_m[class_id]
    is_last = labels == 8
    whole.sightings.sizes[:, 0] = np.where(is_last, usual_m, 0.85 * usual_m)
    whole.sightings.covariances[is_last, 0, 0] = 0.6**2
    whole.sightings.sides[:, 0] = -1.0  # the lidars see the rear
    found = estimated(whole, labels, PRIORS)
    shorter = 1 - found.sizes[8, 0] / usual_m
    assert shorter == pytest.approx(0.15 * 8 / 9 * 0.15**2 / (0.15**2 + 0.1**2) if class_id == CAR else 0.0, abs=0.01)
    np.testing.assert_allclose(found.motions.states[-1, 0], -shorter * usual_m / 2, atol=0.02)


def test_boxes_of_a_longer_class_show_the_whole_and_those_of_a_shorter_one_parts() -> None:
    whole, labels = one_track(scene([Mover(straight(0, 0, 0, 0), class_id=TRUCK)], 40, noise_m=0.01))
    turn = np.arange(40) % 4
    whole.sightings.class_ids[:] = np.choose(turn, [BUS, TRUCK, TRUCK, CAR])
    whole.sightings.sizes[:] = np.array([[12.0, 2.5, 3.0], [8.0, 2.0, 2.0], [8.0, 2.0, 2.0], [4.0, 1.7, 1.5]])[turn]
    whole.sightings.covariances[turn > 0, 0, 0] = 0.3**2
    whole.sightings.sides[:, 0] = 1.0
    found = estimated(whole, labels, PRIORS)
    assert found.class_ids[0] == TRUCK
    assert found.sizes[0, 0] == 12.0


def test_what_is_known_stays() -> None:
    whole, labels = one_track(scene([Mover(straight(0, 0, 0, 0))], 20))
    known = History.none(1, len(PRIORS))
    known.sizes[:], known.headings[:] = [4.4, 1.8, 1.5], np.pi
    known.votes[0, CAR + 3], known.fronts_known[:] = 100.0, True
    found = estimated(whole, labels, PRIORS, known)
    assert found.sizes[0].tolist() == [4.4, 1.8, 1.5]
    assert found.class_ids[0] == CAR + 3
    assert found.fronts_known[0]
    assert np.cos(found.motions.states[:, HEADING]).max() < -0.9


def test_tracks_are_ordered_by_their_first_sighting() -> None:
    whole = Scene.of(scene([Mover(straight(0, 0, 0, 0)), Mover(straight(9, 0, 0, 0))], 4))
    labels = renumbered(np.where(np.arange(8) % 2 == 0, 7, 3))
    found = estimated(whole, labels, PRIORS)
    assert found.motions.states[found.courses.starts[:-1], 0] == pytest.approx([0, 9], abs=0.3)
    assert found.labels(8).tolist() == [0, 1] * 4
    assert whole.stamps_ns[0] == START_NS


@pytest.mark.parametrize(("beside_m", "joined"), [(0.3, [0, 0]), (1.7, [0, 1])])
def test_tracks_on_the_same_ground_are_one(beside_m: float, joined: list[int]) -> None:
    movers = [Mover(straight(0, y, 0, 0.5)) for y in (0.0, beside_m)]
    found = estimated(Scene.of(scene(movers, 20)), np.tile([0, 1], 20), PRIORS)
    assert joined_in_place(found).tolist() == joined


def test_a_doubtful_track_between_two_others_does_not_join_them() -> None:
    doubtful = Mover(straight(0, 1.2, 0, 0.5), seen=lambda k: k == 10)
    whole = Scene.of(scene([Mover(straight(0, 0, 0, 0.5)), Mover(straight(0, 2.2, 0, 0.5)), doubtful], 20))
    labels = [label for frame in range(20) for label in range(3 if frame == 10 else 2)]
    assert joined_in_place(estimated(whole, np.array(labels), PRIORS)).tolist() == [0, 1, 1]


@pytest.mark.parametrize(
    ("beside_m", "crosses", "rig_m_s", "direction"),
    [
        (3.2, 0.0, 0.0, np.pi),
        (6.0, 0.0, 0.0, 0.0),
        (3.2, 1.2, 0.0, 0.0),
        (60.0, 0.0, -5.0, np.pi),
        (60.0, 0.0, 0.0, 0.0),
    ],
    ids=["past it", "in the next lane but one", "across", "the rig", "far away"],
)
def test_what_stands_looks_the_way_of_the_lane_beside_it(
    beside_m: float, crosses: float, rig_m_s: float, direction: float
) -> None:
    driver = Mover(straight(8, beside_m, np.pi + crosses, 8.0))
    frames = scene([Mover(straight(0, 0, 0, 0)), driver], 20)
    for index, frame in enumerate(frames):
        frame.T_fixed_site[:2, 3] = 4 + rig_m_s * PERIOD_S * index, -3.0
        frame.sightings.show_front[:] = False
    found = estimated(Scene.of(frames), np.tile([0, 1], 20), PRIORS)
    assert np.cos(found.motions.states[:20, HEADING] - direction).min() > 0.9
    assert found.fronts_known.tolist() == [False, True]


@pytest.mark.parametrize(("every", "direction"), [(1, np.pi), (3, 0.0)])
def test_a_track_that_is_seldom_seen_defines_no_lane(every: int, direction: float) -> None:
    driver = Mover(straight(8, 3.2, np.pi, 8.0), seen=lambda k: k % every == 0)
    frames = scene([Mover(straight(0, 0, 0, 0)), driver], 31)
    for frame in frames:
        frame.sightings.show_front[:] = False
    labels = [label for frame in frames for label in range(len(frame.sightings))]
    found = estimated(Scene.of(frames), np.array(labels), PRIORS)
    assert np.cos(found.motions.states[:31, HEADING] - direction).min() > 0.9


@pytest.mark.parametrize(("turned", "direction"), [(lambda _: False, 0.0), (lambda k: k % 2 == 0, np.pi)])
def test_the_lane_is_one_vote_beside_those_of_boxes(turned: Callable[[int], bool], direction: float) -> None:
    parked, driver = Mover(straight(0, 0, 0, 0), turned=turned), Mover(straight(8, 3.2, np.pi, 8.0))
    found = estimated(Scene.of(scene([parked, driver], 40)), np.tile([0, 1], 40), PRIORS)
    assert np.cos(found.motions.states[:40, HEADING] - direction).min() > 0.9


def test_what_stands_is_not_turned_by_the_boxes_of_few_points_that_it_begins_with() -> None:
    whole, labels = one_track(scene([Mover(straight(0, 0, 0, 0))], 60))
    quarter = np.array([0, 1, 2, 4])
    whole.sightings.boxes[quarter] += [-1.0, 1.1, np.pi / 2]
    found = estimated(whole, labels, PRIORS)
    assert found.standing.all()
    assert np.abs(found.motions.states[:, TURN]).max() < 0.05
    assert np.abs(np.sin(found.motions.states[:, HEADING])).max() < 0.1


def test_a_first_box_beside_a_parked_car_does_not_hold_it_there() -> None:
    """Twice a second, so that it could have driven from there."""
    whole, labels = one_track(scene([Mover(straight(0, 0, 0, 0))], 50)[::5])
    whole.sightings.boxes[0] += [-1.5, 4.9, 0.4]
    whole.sightings.covariances[0] *= 16
    found = estimated(whole, labels, PRIORS)
    np.testing.assert_allclose(found.motions.states[:, :2], 0.0, atol=0.3)


def test_boxes_across_a_vehicle_that_stands_do_not_turn_it_round() -> None:
    across = {20 + k: 0.3 + 0.3 * k for k in range(9)}
    frames = scene([Mover(lambda t: (0.9 * (t > 2.4), 0.0, across.get(round(t / PERIOD_S), 0.0)))], 40)
    found = estimated(*one_track(frames), PRIORS)
    assert np.cos(found.motions.states[:, HEADING]).min() > 0.8


def test_a_box_across_after_a_gap_does_not_turn_what_drives() -> None:
    def place(t: float) -> tuple[float, float, float]:
        return 10.0 * t, 0.0, 1.3 if round(t / PERIOD_S) == 45 else 0.0

    whole, labels = one_track(scene([Mover(place)], 60, noise_m=0.1))
    labels[30:45] = -1
    found = estimated(whole, labels, PRIORS)
    np.testing.assert_allclose(found.motions.states[:, 1], 0.0, atol=1.0)
    np.testing.assert_allclose(found.motions.states[:, HEADING], 0.0, atol=0.2)


def wandering(t: float) -> tuple[float, float, float]:
    """Places of a parked car of few points: off by up to two metres at first, then less."""
    return 2.0 * np.sin(37.0 * t) * max(0.1, 1.0 - t), 0.3 * np.sin(23.0 * t), 0.0


def there_and_back(t: float) -> tuple[float, float, float]:
    return 2.0 * np.sin(np.pi * t / 3.0), 0.0, 0.0


@pytest.mark.parametrize(
    ("place", "stands"), [(wandering, True), (straight(0, 0, 0, 0.4), False), (there_and_back, False)]
)
def test_what_stands_by_the_scatter_of_its_places(place: Place, stands: bool) -> None:
    found = estimated(*one_track(scene([Mover(place)], 30)), PRIORS)
    assert found.standing.all() == stands


def test_what_waits_for_long_drives_off_all_the_same() -> None:
    frames = scene([Mover(lambda t: (max(0.0, t - 4.0) ** 2, 0.0, 0.0))], 60)
    found = estimated(*one_track(frames), PRIORS)
    assert found.standing[:35].all()
    assert not found.standing[-10:].any()
    assert found.motions.states[-1, 0] == pytest.approx(1.9**2, abs=0.3)
    assert found.fronts_known.all()
