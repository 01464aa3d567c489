"""Road users: each track once, whatever it does from frame to frame."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from frames import CONFIG, RIG
from hypothesis import given, settings
from hypothesis import strategies as st
from tracked_frames import Seen, tracked_frame

from lidcam.pipeline.core.rig import Rig, Zone
from lidcam.pipeline.core.tracks import MIN_MOVING_SPEED_M_S
from lidcam.pipeline.evaluation.road_users import RoadUserCount, RoadUsers, RoadUserTally
from lidcam.run.tally import Tally

SQUARE = np.array([[-10.0, 0.0], [10.0, 0.0], [10.0, 10.0], [-10.0, 10.0]])
ZONED = replace(RIG, zones=(Zone("north", SQUARE), Zone("south", SQUARE * [1, -1]), Zone("off", SQUARE * 3, "ignore")))
NORTH, SOUTH, OUTSIDE = 5.0, -5.0, 50.0
"""y of a place in the middle of each."""
CAR, BUS = CONFIG.class_id_of_label["car"], CONFIG.class_id_of_label["bus"]
UNKNOWN = len(CONFIG.class_names)


def users_of(frames: Iterable[tuple[Seen, ...]], rig: Rig = ZONED) -> RoadUsers:
    tally = RoadUserTally(CONFIG, rig)
    for index, seen in enumerate(frames):
        tally.add_frame(tracked_frame(index, *seen))
    assert tally.road_users is not None
    return tally.road_users


def test_without_tracks_there_is_no_telling() -> None:
    tally = RoadUserTally(CONFIG, ZONED)
    assert tally.road_users is None
    tally.add_frame(tracked_frame(0, Seen(0, 0, NORTH), is_tracked=False))
    assert tally.road_users is None
    tally.add_frame(tracked_frame(1))
    assert tally.road_users == RoadUsers((), ())


def test_a_run_counts_them_with_all_else() -> None:
    tally = Tally(CONFIG, ZONED)
    tally.add_frame(tracked_frame(0, Seen(1, 0, NORTH, 3.0), Seen(0, 0, NORTH)))
    assert tally.objects == {("car", "north"): 2}
    users = tally.road_users.road_users
    assert users is not None
    assert users.counts[-1] == RoadUserCount("car", "", 1, 1, 0, 3.0, 3.0)


def test_what_is_of_no_class_or_no_track_is_no_road_user() -> None:
    frames = [(Seen(0, 0, NORTH, 1.0), Seen(0, 3, NORTH, 1.0, UNKNOWN), Seen(5, 3, NORTH, 1.0, UNKNOWN))]
    assert users_of(frames) == RoadUsers((), ())


seen_objects = st.builds(
    Seen,
    st.integers(0, 150),
    st.just(0.0),
    st.sampled_from([NORTH, SOUTH, OUTSIDE]),
    st.integers(0, 20).map(float),
    st.sampled_from([CAR, BUS]),
)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(seen_objects, max_size=8, unique_by=lambda one: one.track).map(tuple), max_size=8))
def test_a_plain_count_agrees(frames: list[tuple[Seen, ...]]) -> None:
    """Track by track, by plain loops over all that was seen of each."""
    of_track: dict[int, list[Seen]] = defaultdict(list)
    for seen in frames:
        for one in seen:
            if one.track:
                of_track[one.track].append(one)
    means, went = defaultdict(list), Counter[tuple[str, float, float]]()
    for track in of_track.values():
        votes = Counter(one.class_id for one in track)
        name = CONFIG.class_names[min(votes, key=lambda class_id: (-votes[class_id], class_id))]
        for place in (NORTH, SOUTH, OUTSIDE, None):
            speeds = [one.speed_m_s for one in track if place in (one.y, None)]
            if speeds:
                fastest = max(one.speed_m_s for one in track)
                means[name, place].append(((sum(speeds) / len(speeds), max(speeds)), fastest))
        zones = [one.y for one in track if one.y != OUTSIDE]
        if zones and zones[0] != zones[-1]:
            went[name, zones[0], zones[-1]] += 1
    tally = RoadUserTally(CONFIG, ZONED)
    for index, seen in enumerate(frames):
        tally.add_frame(tracked_frame(index, *seen))
    users = tally.road_users or RoadUsers((), ())
    places = {"north": NORTH, "south": SOUTH, "outside": OUTSIDE, "": None}
    found = {(count.class_name, places[count.zone]): count for count in users.counts}
    assert found.keys() == means.keys()
    for key, count in found.items():
        moved = [speeds for speeds, fastest in means[key] if fastest >= MIN_MOVING_SPEED_M_S]
        assert (count.count, count.moved, count.stood) == (len(means[key]), len(moved), len(means[key]) - len(moved))
        if moved:
            assert count.speed_mean_m_s == pytest.approx(np.mean([mean for mean, _ in moved]))
            assert count.speed_max_m_s == max(highest for _, highest in moved)
        else:
            assert np.isnan([count.speed_mean_m_s, count.speed_max_m_s]).all()
    changes = {(one.class_name, places[one.from_zone], places[one.to_zone]): one.count for one in users.changes}
    assert changes == went


def test_speeds_that_are_not_known_are_in_no_mean() -> None:
    """Of four cars one moved, one was fast by chance at most, of one no speed was known, and one was slow at times."""
    tally = RoadUserTally(CONFIG, ZONED)
    numbers, centers = np.array([1, 3, 5, 7]), np.zeros((4, 3))
    for speeds in ([np.nan, np.nan, np.nan, 0.1], [4.0, 9.0, np.nan, 0.9], [2.0, 9.0, np.nan, 0.9]):
        moving = np.array([speeds[0] > 3, False, False, False])
        tally.add_objects(0, np.zeros(4, np.int32), centers, numbers, np.array(speeds), moving)
    np.testing.assert_array_equal(tally.table.speed_means[:3], [3.0, 9.0, np.nan])
    np.testing.assert_array_equal(tally.table.speed_maxima, [4.0, 9.0, np.nan, 0.9])
    assert tally.road_users is not None
    (whole,) = (one for one in tally.road_users.counts if not one.zone)
    assert whole == RoadUserCount("car", "", 4, 1, 1, 3.0, 4.0)
    assert tally.table.moved.tolist() == [True, False, False, False]
    assert tally.table.stood.tolist() == [False, False, False, True]
    none = RoadUserTally(CONFIG, ZONED)
    none.add_objects(0, np.zeros(1, np.int32), centers[:1], numbers[:1], np.array([np.nan]), np.zeros(1, np.bool_))
    assert none.road_users is not None
    assert np.isnan(none.road_users.counts[-1].speed_mean_m_s)


def test_how_long_each_stays_where() -> None:
    """From frame to frame a road user stays where it was; what is not in the next frame has gone."""
    tally = RoadUserTally(CONFIG, ZONED)
    for index, seen in enumerate(
        [(Seen(1, 0, NORTH, 4.0),), (Seen(1, 0, NORTH, 2.0), Seen(7, 1, SOUTH)), (Seen(1, 0, OUTSIDE),), ()]
    ):
        tally.add_frame(tracked_frame(index, *seen))
    table, step_s = tally.table, 0.1
    assert table.places == ("outside", "north", "south")
    assert tally.numbers == (1, 7)
    np.testing.assert_allclose(table.seconds, np.array([[0, 2 * step_s, 0], [0, 0, 0]]), atol=1e-9)
    np.testing.assert_array_equal(table.frames, [[1, 2, 0], [0, 0, 1]])
    np.testing.assert_allclose(table.speed_means, [2.0, 0.0])
    np.testing.assert_allclose(table.speed_maxima, [4.0, 0.0])
    assert (table.first_zones.tolist(), table.last_zones.tolist()) == ([1, 2], [1, 2])
