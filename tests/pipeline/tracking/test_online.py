from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tracked_scenes import BICYCLE, CAR, PEDESTRIAN, PERIOD_S, PRIORS, Mover, scene, straight

from lidcam.pipeline.tracking.motion import HEADING, SPEED, TURN
from lidcam.pipeline.tracking.online import OnlineTracker
from lidcam.pipeline.tracking.sightings import NOT_SEEN, FrameSightings, TrackRows


def tracked(frames: list[FrameSightings]) -> list[TrackRows]:
    tracker = OnlineTracker(PRIORS, min_existence=0.5, max_gap_s=3.0)
    return [rows for frame in frames for rows in tracker.add_frame(frame)] + tracker.finish()


@pytest.mark.parametrize("movers", [[], [Mover(straight(0, 0, 0, 0))]])
def test_nothing_and_what_stands(movers: list[Mover]) -> None:
    rows = tracked(scene(movers, 10))
    assert [len(row) for row in rows] == [len(movers)] * 10


def test_one_car_has_one_number_and_its_speed() -> None:
    rows = tracked(scene([Mover(straight(-10, 3, 0.4, 8.0))], 30))
    assert {number for row in rows for number in row.ids.tolist()} == {1}
    last = rows[-1]
    assert last.states[0, SPEED] == pytest.approx(8.0, abs=0.3)
    assert last.states[0, HEADING] == pytest.approx(0.4, abs=0.05)
    assert last.fronts_known.all()
    assert last.ages_s == pytest.approx([29 * PERIOD_S])


def test_what_stands_is_not_driven_by_noise_and_starts_at_once() -> None:
    start_s = 3.0
    car = Mover(lambda t: (2.5 * max(t - start_s, 0.0) ** 2 / 2, 0.0, 0.0))
    speeds = np.array([rows.states[0, SPEED] for rows in tracked(scene([car], 60, noise_m=0.1))])
    assert np.abs(speeds[15:30]).max() < 0.1
    assert speeds[45:] == pytest.approx(2.5 * PERIOD_S * np.arange(15, 30), abs=1.0)


@pytest.mark.parametrize(
    ("class_id", "m_s", "noise_m"),
    [(CAR, 3.0, 0.05), (CAR, 3.0, 0.15), (CAR, 8.0, 0.15), (PEDESTRIAN, 1.4, 0.05), (BICYCLE, 4.0, 0.15)],
)
def test_a_new_speed_is_known_once_the_track_stands_or_moves(class_id: int, m_s: float, noise_m: float) -> None:
    one = Mover(straight(-10, 3, 0.4, m_s), class_id=class_id)
    rows = [rows for rows in tracked(scene([one], 12, noise_m=noise_m)) if rows.speeds_known.any()]
    assert len(rows) >= 5
    assert min(row.states[0, SPEED] for row in rows[:3]) > 0.75 * m_s


def test_the_speed_of_what_stands_is_known_at_once() -> None:
    rows = tracked(scene([Mover(straight(-10, 3, 0.4, 0.0))], 12, noise_m=0.1))
    assert [row.speeds_known.all() for row in rows] == [False] * 2 + [True] * 10


def test_boxes_that_are_turned_round_do_not_turn_the_track() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0.0, 6.0), turned=lambda k: k % 3 != 2)], 30))
    assert all(abs(row.states[0, HEADING]) < 0.2 for row in rows[10:])
    assert all(row.states[0, SPEED] > 0 for row in rows[10:])


@pytest.mark.parametrize("turned_rad", [np.pi / 2, 0.7])
def test_boxes_across_the_way_do_not_turn_a_car_that_drives(turned_rad: float) -> None:
    """In three frames, its length is taken for its width, or two of its corners for a side."""
    rows = tracked(scene([Mover(lambda t: (6 * t, 0.0, turned_rad * (0.95 < t < 1.25)))], 30))
    assert {number for row in rows for number in row.ids.tolist()} == {1}
    assert all(abs(row.states[0, HEADING]) < 0.15 for row in rows)


def test_a_car_that_reverses_a_little_keeps_its_front() -> None:
    rows = tracked(scene([Mover(lambda t: (-1.5 * max(t - 2.0, 0.0), 0.0, 0.0))], 50))
    assert all(abs(row.states[0, HEADING]) < 0.2 for row in rows)
    assert all(row.states[0, SPEED] < -1.0 for row in rows[30:])


def test_boxes_that_do_not_show_the_front_do_not_choose_it() -> None:
    frames = scene([Mover(straight(0, 0, 0, 0), turned=lambda index: index > 4)], 20)
    for one in frames[5:]:
        one.sightings.show_front[:] = False
    assert all(abs(row.states[0, HEADING]) < 0.2 for row in tracked(frames))


def test_wrong_headings_do_not_set_what_stands_spinning() -> None:
    # A parked car far away, as a real drive showed it.
    begin = [(0.2, -0.1, 0.43), (-0.2, 0.7, 1.01), (-0.3, 0.7, 1.01), (-0.1, 0.0, 1.95), (0.1, -0.1, 0.4)]
    frames = scene([Mover(lambda t: dict(enumerate(begin)).get(round(t / PERIOD_S), (0.0, 0.0, 0.0)))], 25)
    states = np.concatenate([rows.states for rows in tracked(frames)])
    assert (np.abs(states[:, TURN]) <= np.abs(states[:, SPEED]) / PRIORS.scales_m[CAR]).all()
    assert abs(np.sin(states[-1, HEADING])) < 0.1


@pytest.mark.parametrize("few", [5, 50])
def test_its_size_is_that_of_the_boxes_with_many_points(few: int) -> None:
    """A car that comes near: the short boxes of its first frames are soon outweighed."""
    frames = scene([Mover(straight(40, 0, np.pi, 8.0))], 20)
    for one in frames[:10]:
        one.sightings.sizes[:, 0], one.sightings.point_counts[:] = 3.0, few
    for one in frames[10:]:
        one.sightings.point_counts[:] = 500
    lengths_m = [row.sizes[0, 0] for row in tracked(frames)]
    assert lengths_m[9] == pytest.approx(3.0)
    assert lengths_m[11] == pytest.approx(3.0 + 1000 / (1000 + 10 * few))


def test_its_size_is_not_that_of_boxes_of_another_class() -> None:
    """Two cyclists side by side, who begin as a car."""
    frames = scene([Mover(straight(-10, 0, 0, 5.0), class_id=BICYCLE, size=(1.8, 0.6, 1.7))], 20)
    for one in frames[:2]:
        one.sightings.class_ids[:], one.sightings.sizes[:] = CAR, [4.0, 1.7, 1.5]
    rows = tracked(frames)
    assert rows[1].sizes[0] == pytest.approx([4.0, 1.7, 1.5])
    assert rows[-1].sizes[0] == pytest.approx([1.8, 0.6, 1.7])


def test_improbable_boxes_beside_it_do_not_drive_off_with_a_parked_car() -> None:
    """As of a hedge that is seen further on in each frame."""
    parked = Mover(straight(0, 0, 0, 0), seen=lambda k: k < 20)
    hedge = Mover(lambda t: (4 * (t - 1.9), 0.3, 0), belief=0.3, seen=lambda k: k >= 20)
    rows = [rows for rows in tracked(scene([parked, hedge], 30, noise_m=0.1)) if len(rows)]
    assert len(rows) >= 20
    assert np.abs([row.states[0, [0, SPEED]] for row in rows[20:]]).max(initial=0.0) < 0.5


def test_cars_that_pass_each_other_keep_their_numbers() -> None:
    movers = [Mover(straight(-20, 0, 0, 10.0)), Mover(straight(20, 3.5, np.pi, 10.0))]
    rows = tracked(scene(movers, 40))
    for row in rows[5:]:
        assert row.ids.tolist() == [1, 2]
        assert row.states[0, 1] < row.states[1, 1]


def test_parked_cars_do_not_drive_to_the_next_place() -> None:
    """A rig passes a row of them once a second: it comes to see one, and another is out of sight."""
    row = [Mover(straight(6.0 * k, 0, 0, 0), seen=range(10 * k, 10 * k + 30).__contains__) for k in range(8)]
    for rows in tracked(scene(row, 80)[::10])[2:]:
        np.testing.assert_allclose(rows.states[:, 0], 6.0 * (rows.ids - 1), atol=0.3)


def test_people_side_by_side_have_a_track_each() -> None:
    movers = [Mover(straight(0, 0.6 * row, 0, 1.4), PEDESTRIAN, (0.6, 0.6, 1.7)) for row in range(3)]
    assert [row.ids.tolist() for row in tracked(scene(movers, 30))] == [[1, 2, 3]] * 30


def test_a_pause_is_bridged_and_a_long_one_ends_the_track() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 5.0), seen=lambda k: k not in (10, 11) and not 20 < k < 40)], 50))
    assert rows[10].seen.tolist() == [NOT_SEEN]
    assert rows[12].ids.tolist() == [1]
    assert rows[30].ids.tolist() == []
    assert rows[45].ids.tolist() == [2]


@pytest.mark.parametrize(("frames_sure", "last"), [(10, 26), (60, 36)])
def test_evidence_fades(frames_sure: int, last: int) -> None:
    """A track that was sure for long is doubted after little more frames than one that was sure for a second."""
    sure = Mover(straight(0, 0, 0, 0), seen=lambda k: k < frames_sure)
    doubted = Mover(straight(0, 0, 0, 0), belief=0.3, seen=lambda k: k >= frames_sure)
    rows = tracked(scene([sure, doubted], frames_sure + 60))
    assert max(index for index, row in enumerate(rows) if len(row)) - frames_sure <= last
    existence = [row.existence[0] for row in rows[:frames_sure]]
    assert existence == sorted(existence)
    assert len(set(existence)) == len(existence), "what is sure keeps an order"


@pytest.mark.parametrize(("speed", "later_s"), [(10.0, 0.05), (30.0, 0.1)])
def test_measurements_at_their_own_time_do_not_lag(speed: float, later_s: float) -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, speed))], 30, noise_m=0.01, later_s=later_s))
    assert {number for row in rows for number in row.ids.tolist()} == {1}
    assert rows[1].states[0, SPEED] == pytest.approx(speed, rel=0.2)
    assert rows[-1].states[0, 0] == pytest.approx(speed * 29 * PERIOD_S, abs=0.15)


def test_what_is_improbable_begins_no_track_but_carries_one_on() -> None:
    car = straight(0, 0, 0, 4.0)
    assert not any(len(row) for row in tracked(scene([Mover(car, belief=0.3)], 10)))
    frames = scene([Mover(car)], 10) + scene([Mover(car, belief=0.3)], 14)[10:]
    assert tracked(frames)[-1].ids.tolist() == [1]


@pytest.mark.parametrize(
    ("belief", "seen", "first"), [(0.6, [0], 0), (0.6, [7], None), (0.6, range(7, 20), 13), (0.99, range(7, 20), 7)]
)
def test_a_track_is_doubted_by_the_frames_before_it(belief: float, seen: Sequence[int], first: int | None) -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 0), belief=belief, seen=lambda k: k in seen)], 20))
    assert next((index for index, row in enumerate(rows) if len(row)), None) == first


def test_the_class_is_one_belief_over_the_track() -> None:
    rows = tracked(scene([Mover(straight(0, 0, 0, 1.0), classes=[CAR, CAR, PEDESTRIAN])], 12))
    assert [row.class_ids.tolist() for row in rows[2:]] == [[CAR]] * 10


def test_after_a_jump_of_time_all_tracks_are_new() -> None:
    first = scene([Mover(straight(0, 0, 0, 8.0))], 20)
    second = scene([Mover(straight(500, 0, 0, 8.0), seen=lambda index: index >= 10)], 20)
    before = [replace(one, stamp_ns=one.stamp_ns - 60 * 10**9) for one in second]
    rows = tracked([*first, *before])
    assert [row.ids.tolist() for row in rows] == [[1]] * 20 + [[]] * 10 + [[2]] * 10
    assert rows[-1].ages_s == pytest.approx([9 * PERIOD_S])


@pytest.mark.parametrize(("hits", "gap"), [(2, 4), (6, 11)])
def test_limits_of_time_hold_whenever_an_object_appears(hits: int, gap: int) -> None:
    def seen(first: int) -> set[int]:
        shown = [*range(first, first + hits), *range(first + hits + gap - 1, first + hits + gap + 10)]
        other = Mover(straight(100, 50, 0, 0))
        rows = tracked(scene([other, Mover(straight(0, 0, 0, 0), seen=shown.__contains__)], first + hits + gap + 10))
        return {int(number) for row in rows for number in row.ids[np.abs(row.states[:, 1]) < 5]}

    assert [len(seen(first)) for first in range(1, 15)] == [1] * 14


def test_what_is_less_probable_than_asked_for_is_not_reported() -> None:
    tracker = OnlineTracker(PRIORS, min_existence=0.99, max_gap_s=3.0)
    movers = [Mover(straight(10.0 * row, 0, 0, 0), belief=belief) for row, belief in enumerate((0.9, 0.95, 0.98, 0.99))]
    rows = [one for frame in scene(movers, 40) for one in tracker.add_frame(frame)]
    assert sum(map(len, rows)) > 20
    assert min(row.existence.min(initial=1.0) for row in rows) >= 0.99
