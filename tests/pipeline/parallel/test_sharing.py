import pytest

from pipeline.parallel.run import Sharing


def sharing(workers: int, expected: int, frame_s: float) -> Sharing:
    found = Sharing(workers, expected)
    for seconds in (10.0, frame_s):  # the first frame compiles
        assert found.more(0, 1) == 0
        found.took(seconds)
    return found


@pytest.mark.parametrize(
    ("workers", "expected", "others", "done", "more"),
    [
        (1, 10_000, 0, 2, 0),
        (2, 10_000, 0, 2, 1),
        (2, 10_000, 1, 2, 0),
        (8, 10_000, 0, 2, 1),
        (8, 10_000, 1, 2, 2),
        (8, 10_000, 3, 2, 4),
        (6, 10_000, 3, 2, 2),
        (8, 30, 0, 2, 1),
        (8, 30, 1, 2, 0),  # 2.8 s of work: two processes
        (2, 20, 0, 2, 0),  # a start would cost more than it gives
        (2, 20, 0, 50, 0),  # more frames than expected
    ],
)
def test_another_process_where_it_is_worth_its_start(
    workers: int, expected: int, others: int, done: int, more: int
) -> None:
    assert sharing(workers, expected, 0.1).more(others, done) == more
    assert sharing(workers, expected, 0.1).at_once == 0


def test_a_start_that_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.parallel.run.START_S", 0.0)
    found = sharing(4, 1, 0.001)
    assert (found.at_once, found.more(3, 0)) == (3, 0)
