import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.evaluation.comparison.frames import paired_frames
from lidcam.pipeline.evaluation.evaluation_frame import ResultFrame

MAX_APART_NS = 10
Pairs = list[tuple[int | None, int | None]]


def frames(stamps_ns: list[int]) -> list[ResultFrame]:
    return [ResultFrame(index, stamp_ns, stamp_ns, {}, {}) for index, stamp_ns in enumerate(stamps_ns)]


def paired(first: list[int], second: list[int]) -> tuple[Pairs, list[bool]]:
    """Rows of each pair, and whether it follows the one before it."""
    found = list(paired_frames(frames(first), frames(second), max_apart_ns=MAX_APART_NS))
    rows = [
        (one.first.index if one.first is not None else None, one.second.index if one.second is not None else None)
        for one in found
    ]
    return rows, [one.is_next for one in found]


@pytest.mark.parametrize(
    ("first", "second", "pairs"),
    [
        pytest.param([], [], [], id="empty"),
        pytest.param([5], [], [(0, None)], id="A alone"),
        pytest.param([], [5], [(None, 0)], id="B alone"),
        pytest.param([0, 100, 200], [0, 100, 200], [(0, 0), (1, 1), (2, 2)], id="same"),
        pytest.param([0, 100, 200], [0, 200], [(0, 0), (1, None), (2, 1)], id="one missing in B"),
        pytest.param([100], [0, 100, 200], [(None, 0), (0, 1), (None, 2)], id="part of it in A"),
        pytest.param([0, 100], [10, 90], [(0, 0), (1, 1)], id="as far apart as may be"),
        pytest.param([0], [11], [(0, None), (None, 0)], id="too far apart"),
        pytest.param([0, 10], [9], [(0, None), (1, 0)], id="the nearer one of A"),
        pytest.param([9], [0, 10], [(None, 0), (0, 1)], id="the nearer one of B"),
        pytest.param([0, 10], [5], [(0, 0), (1, None)], id="the earlier of two that are as near"),
        pytest.param([0, 0], [0, 0], [(0, 0), (1, 1)], id="a stamp twice"),
    ],
)
def test_pairs(first: list[int], second: list[int], pairs: Pairs) -> None:
    assert paired(first, second)[0] == pairs


def test_parts_of_a_recording_whose_time_jumps_back_are_paired_in_their_order() -> None:
    rows, follow = paired([500, 600, 0, 100], [500, 600, 700, 0, 100])
    assert rows == [(0, 0), (1, 1), (None, 2), (2, 3), (3, 4)]
    assert follow == [True, True, True, False, True]


def test_a_part_that_only_one_result_has() -> None:
    rows, _ = paired([500, 600], [500, 600, 0, 100])
    assert rows == [(0, 0), (1, 1), (None, 2), (None, 3)]


STAMPS = st.lists(st.integers(0, 120), max_size=12)


@given(first=STAMPS, second=STAMPS)
@settings(derandomize=True)
def test_every_frame_comes_once_and_in_order(first: list[int], second: list[int]) -> None:
    rows, _ = paired(first, second)
    assert [row for row, _ in rows if row is not None] == [*range(len(first))]
    assert [row for _, row in rows if row is not None] == [*range(len(second))]
    for a, b in rows:
        if a is not None and b is not None:
            assert abs(first[a] - second[b]) <= MAX_APART_NS


@given(stamps_ns=STAMPS)
@settings(derandomize=True)
def test_every_frame_is_its_own_partner(stamps_ns: list[int]) -> None:
    assert paired(stamps_ns, stamps_ns)[0] == [(row, row) for row in range(len(stamps_ns))]
