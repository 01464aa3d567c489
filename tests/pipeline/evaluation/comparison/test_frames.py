import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.evaluation.comparison.comparison import MAX_APART_NS, paired_frames
from lidcam.pipeline.evaluation.evaluation_frame import ResultFrame

MS = 1_000_000
Pairs = list[tuple[int | None, int | None]]


def frames(stamps_ms: list[int]) -> list[ResultFrame]:
    return [ResultFrame(index, stamp * MS, stamp * MS, {}, {}) for index, stamp in enumerate(stamps_ms)]


def paired(first: list[int], second: list[int]) -> Pairs:
    """Rows of each pair."""
    return [
        (None if one is None else one.index, None if other is None else other.index)
        for one, other in paired_frames(frames(first), frames(second))
    ]


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
    assert paired(first, second) == pairs


STAMPS = st.lists(st.integers(0, 120), max_size=12)


@given(first=STAMPS, second=STAMPS)
@settings(derandomize=True)
def test_every_frame_comes_once_and_in_order(first: list[int], second: list[int]) -> None:
    rows = paired(first, second)
    assert [row for row, _ in rows if row is not None] == [*range(len(first))]
    assert [row for _, row in rows if row is not None] == [*range(len(second))]
    for a, b in rows:
        if a is not None and b is not None:
            assert abs(first[a] - second[b]) * MS <= MAX_APART_NS
