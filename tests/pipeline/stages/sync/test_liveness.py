import pytest

from lidcam.pipeline.stages.sync.liveness import Liveness

MS = 1_000_000


def hear(liveness: Liveness, topic: int, *, at_ms: int, stamp_ms: int | None = None) -> tuple[list[int], bool]:
    """Topics that fell silent before the message, and whether its own was silent."""
    silent = liveness.advance(at_ms * MS)
    return [*silent], liveness.hear(topic, (at_ms if stamp_ms is None else stamp_ms) * MS)


def test_every_topic_is_waited_for_from_the_start() -> None:
    liveness = Liveness(2, silent_after_ns=500 * MS)
    told = {at_ms: hear(liveness, 0, at_ms=at_ms) for at_ms in range(1000, 1701, 100)}
    assert {at_ms: result for at_ms, result in told.items() if result != ([], False)} == {1600: ([1], False)}
    assert [liveness.is_alive(topic) for topic in (0, 1)] == [True, False]
    assert hear(liveness, 1, at_ms=1750) == ([], True)
    assert liveness.is_alive(1)


def test_a_slow_topic_has_more_time() -> None:
    liveness = Liveness(2, silent_after_ns=500 * MS)
    for at_ms in range(0, 10_000, 100):
        assert hear(liveness, 0, at_ms=at_ms) == ([], False)
        if at_ms % 1000 == 0:
            assert hear(liveness, 1, at_ms=at_ms) == ([], False)
    assert liveness.period_ns(1) == 1000 * MS
    told = [at_ms for at_ms in range(10_000, 13_000, 100) if hear(liveness, 0, at_ms=at_ms)[0] == [1]]
    assert told == [11_600]  # 2.5 s after 9 s


def test_stamps_do_not_matter_for_being_alive() -> None:
    liveness = Liveness(2, silent_after_ns=500 * MS)
    for at_ms in range(0, 3000, 100):
        assert hear(liveness, 0, at_ms=at_ms) == ([], False)
        assert hear(liveness, 1, at_ms=at_ms, stamp_ms=at_ms - 2000) == ([], False)


def test_log_times_out_of_order_and_pauses_silence_nobody() -> None:
    liveness = Liveness(3, silent_after_ns=500 * MS)
    for at_ms in (0, 100, 90, 200, 9200, 9300, 9250):
        for topic in range(3):
            assert hear(liveness, topic, at_ms=at_ms) == ([], False)


def test_at_the_end_a_topic_is_silent_that_is_overdue() -> None:
    liveness = Liveness(4, silent_after_ns=500 * MS)
    for at_ms in range(0, 1000, 100):
        hear(liveness, 0, at_ms=at_ms)
        if at_ms <= 600:
            hear(liveness, 1, at_ms=at_ms)
        if at_ms <= 800:
            hear(liveness, 2, at_ms=at_ms)
    assert liveness.is_alive(1)
    assert [*liveness.end()] == [1]
    assert liveness.newest_ns(3) is None


@pytest.mark.parametrize(("until_ms", "silent"), [(0, False), (400, False), (700, True)])
def test_a_topic_that_never_came_is_silent_only_where_enough_was_read_to_expect_it(until_ms: int, silent: bool) -> None:
    """`--duration 0.1` is no fault of the cameras."""
    liveness = Liveness(2, silent_after_ns=500 * MS)
    for at_ms in range(0, until_ms + 1, 100):
        hear(liveness, 0, at_ms=at_ms)
    assert [*liveness.end()] == []
    assert liveness.is_alive(1) is not silent


def test_one_gap_does_not_change_the_period() -> None:
    liveness = Liveness(1, silent_after_ns=500 * MS)
    assert liveness.period_ns(0) == 0
    for at_ms in (0, 100, 200, 3200, 3300, 3300, 3400):
        hear(liveness, 0, at_ms=at_ms)
    assert liveness.period_ns(0) == 100 * MS
