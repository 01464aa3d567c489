from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from evaluation_frames import truth_boxes
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.truth.moment import Moment
from lidcam.readers.truth.timeline import MAX_EXTRAPOLATION_PERIODS, PROBED_GAPS, Timeline

PERIOD_NS = 100_000_000
SPEED_M_S = 10.0


def moment(
    stamp_ns: int,
    ids: Sequence[int] = (7,),
    *,
    x: Sequence[float] | None = None,
    yaws: Sequence[float] | None = None,
    pixels: Sequence[int] | None = None,
    frame_id: str = "site",
) -> Moment:
    """Objects that drive along x from 0 at stamp 0, object k at y = k."""
    n = len(ids)
    xs = np.full(n, SPEED_M_S * stamp_ns * 1e-9) if x is None else np.array(x, np.float64)
    turns = np.zeros(n) if yaws is None else np.array(yaws, np.float64)
    rows = np.column_stack([xs, ids, np.tile([1.0, 4.0, 2.0, 1.5], (n, 1)), turns])
    points = [stamp_ns // PERIOD_NS] * n
    boxes = truth_boxes(rows, ids, labels=["car"] * n, lidar_points=points, image_pixels=[5] * n)
    boxes = replace(boxes, stamp_ns=stamp_ns, frame_id=frame_id)
    return Moment(boxes, {} if pixels is None else {"front": np.array(pixels, np.int32)})


def timeline(*moments: Moment) -> Timeline:
    """A timeline that knows its period, from messages long before."""
    line = Timeline()
    for number in range(PROBED_GAPS + 1):
        line.add_moment(moment((number - PROBED_GAPS - 1000) * PERIOD_NS))
    line._kept.clear()
    for one in moments:
        line.add_moment(one)
    return line


def test_a_step_back_of_time_begins_anew() -> None:
    """A stamp far ahead of all others costs what lies beside it, and no more."""
    line = timeline(moment(0), moment(PERIOD_NS), moment(3600 * 10**9))
    assert not line.reaches(PERIOD_NS + 1)
    line.add_moment(moment(2 * PERIOD_NS))
    line.add_moment(moment(3 * PERIOD_NS))
    assert x_of(line.at(2 * PERIOD_NS + PERIOD_NS // 2)) == [2.5]
    assert line.at(PERIOD_NS) is None


def x_of(found: Moment | None) -> list[float]:
    assert found is not None
    return [round(x, 9) for x in found.boxes.centers[:, 0].tolist()]


def test_messages_of_a_time_come_in_any_order_and_the_last_counts() -> None:
    line = timeline(moment(2 * PERIOD_NS), moment(0), moment(PERIOD_NS, x=[5]), moment(PERIOD_NS))
    assert x_of(line.at(PERIOD_NS // 2)) == [0.5]
    assert x_of(line.at(PERIOD_NS + PERIOD_NS // 2)) == [1.5]


def test_just_beyond_the_ends() -> None:
    line = timeline(moment(0), moment(PERIOD_NS))
    reach = round(MAX_EXTRAPOLATION_PERIODS * PERIOD_NS)
    assert x_of(line.at(-reach)) == [-0.1]
    assert x_of(line.at(PERIOD_NS + reach)) == [1.1]
    assert line.at(-reach - 1) is None
    assert line.at(PERIOD_NS + reach + 1) is None


def test_one_lost_message_is_bridged_but_no_more() -> None:
    assert x_of(timeline(moment(0), moment(2 * PERIOD_NS)).at(PERIOD_NS)) == [1.0]
    line = timeline(moment(0), moment(3 * PERIOD_NS))
    assert line.at(PERIOD_NS) is None
    assert x_of(line.at(PERIOD_NS // 20)) == [0.0]
    assert x_of(line.at(3 * PERIOD_NS - PERIOD_NS // 20)) == [3.0]


@settings(max_examples=25)
@given(st.integers(1, PERIOD_NS - 1), st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.permutations([1, 2, 3]))
def test_interpolation_is_that_of_each_object(stamp_ns: int, yaw: float, turn: float, ids: list[int]) -> None:
    share = stamp_ns / PERIOD_NS
    first = moment(0, (1, 2, 3), x=(0, 5, -3), yaws=(yaw, 0.5, 1))
    end_yaws = {1: float(wrap_angle(yaw + turn)), 2: 0.5, 3: 1.0}
    end_x = {1: 1.0, 2: 4.0, 3: -3.0}
    last = moment(PERIOD_NS, ids, x=[end_x[i] for i in ids], yaws=[end_yaws[i] for i in ids])
    found = timeline(first, last).at(stamp_ns)
    assert found is not None
    for id_, x, heading in zip(found.boxes.track_ids, found.boxes.centers[:, 0], found.boxes.yaws, strict=True):
        begin = {1: 0.0, 2: 5.0, 3: -3.0}[int(id_)]
        assert x == pytest.approx(begin + share * (end_x[int(id_)] - begin))
        if id_ == 1:
            assert abs(wrap_angle(heading - yaw - share * turn)) < 1e-9


def test_objects_that_come_and_go_are_ignored() -> None:
    line = timeline(moment(0, (1, 2), pixels=(10, 20)), moment(PERIOD_NS, (3, 1)))
    found = line.at(PERIOD_NS // 4)
    assert found is not None
    assert found.boxes.track_ids.tolist() == [1, 2, 3]
    assert found.boxes.is_ignored.tolist() == [False, True, True]
    assert x_of(found) == [0.25, 0.0, 1.0]
    assert found.camera_pixels["front"].tolist() == [10, 20, UNKNOWN]


@pytest.mark.parametrize("ids", [(UNKNOWN, UNKNOWN), (4, 4), (1, UNKNOWN)])
def test_objects_without_ids_of_their_own_are_where_the_nearest_message_has_them(ids: tuple[int, int]) -> None:
    line = timeline(moment(0, ids), moment(PERIOD_NS, ids))
    assert x_of(line.at(30_000_000)) == [0.0, 0.0]
    assert x_of(line.at(60_000_000)) == [1.0, 1.0]
    assert (line.nearest, line.farthest_ns) == (2, 40_000_000)
    slow = Timeline()
    for number in range(PROBED_GAPS + 2):
        slow.add_moment(moment(number * 10 * PERIOD_NS, ids))
    assert slow.at(60_000_000) is None  # within half a period, and farther than the objects may have moved
    assert x_of(slow.at(50_000_000)) == [0.0, 0.0]


def test_what_is_no_longer_needed_is_forgotten() -> None:
    line = timeline(*(moment(number * PERIOD_NS) for number in range(10)))
    line.forget(5 * PERIOD_NS + 1)
    assert x_of(line.at(5 * PERIOD_NS + 50_000_000)) == [5.5]
    assert line.at(4 * PERIOD_NS) is None
    line.forget(100 * PERIOD_NS)
    assert x_of(line.at(9 * PERIOD_NS)) == [9.0]


def test_how_far_a_timeline_reaches() -> None:
    line = timeline(moment(0), moment(PERIOD_NS))
    assert line.reaches(PERIOD_NS)
    assert line.reaches(PERIOD_NS - 1)
    assert not line.reaches(PERIOD_NS + 1)
    line.add_moment(moment(50 * PERIOD_NS))
    assert line.reaches(50 * PERIOD_NS)
    assert not line.reaches(30 * PERIOD_NS)
    line.add_moment(moment(51 * PERIOD_NS))
    assert line.reaches(30 * PERIOD_NS)
    assert not timeline(moment(PERIOD_NS)).reaches(0)
