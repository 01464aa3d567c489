import pytest

from lidcam.pipeline.parallel.run import worthwhile


@pytest.mark.parametrize(
    ("workers", "left", "frame_s", "expected"),
    [
        (1, 10_000, 0.1, 1),
        (8, 10_000, 0.1, 8),
        (8, 30, 0.1, 3),
        (2, 19, 0.1, 1),  # a start would cost more than it gives
        (2, -50, 0.1, 1),  # more frames than expected
    ],
)
def test_processes_where_they_are_worth_their_start(workers: int, left: int, frame_s: float, expected: int) -> None:
    assert worthwhile(workers, left, frame_s) == expected


def test_a_start_that_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)
    assert worthwhile(4, 0, 0.001) == 4
