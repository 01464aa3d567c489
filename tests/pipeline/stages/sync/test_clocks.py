"""Impossible stamps are dropped alone, jumps of time split the recording, and nothing else is touched."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.stages.sync.clocks import NO_LOG_TIME, NO_TIME, OUTLIER, ZERO, Clocks, TimeJump

S = 10**9
MS = 10**6
T0_S = 1_700_000_000
CHANNELS = {topic: Channel(topic, "sensor_msgs/msg/Image", "cdr") for topic in "abc"}

Recorded = tuple[str, float | None, float]
"""Topic, stamp in seconds since T0 (None: 0), log time in seconds since T0."""


def message(topic: str, stamp_s: float | None, log_s: float, position: int = 0) -> RawMessage:
    stamp_ns = 0 if stamp_s is None else T0_S * S + round(stamp_s * S)
    return RawMessage(stamp_ns, T0_S * S + round(log_s * S), (0, position), b"", CHANNELS[topic])


def run(
    recorded: Iterable[Recorded], offsets_ns: Mapping[str, int] | None = None
) -> tuple[list[list[tuple[str, float]]], list[tuple[str, float, str]], Clocks]:
    """Topic and stamp of the messages of each part, those dropped, and the clocks."""
    drops: list[Drop] = []
    clocks = Clocks(dict.fromkeys("abc", 0) | dict(offsets_ns or {}), on_drop=drops.append, on_bad=drops.append)
    messages = [message(*one, position) for position, one in enumerate(recorded)]
    parts = [[(m.topic, since_t0(m.stamp_ns)) for m in part] for part in clocks.parts(messages)]
    return parts, [(drop.topic, since_t0(drop.stamp_ns), drop.reason) for drop in drops], clocks


def since_t0(stamp_ns: int) -> float:
    return round(stamp_ns / S - T0_S, 3) if stamp_ns else 0.0


def steady(topics: str = "ab", start: int = 0, stop: int = 10, shift_s: float = 0) -> list[Recorded]:
    """10 Hz from the tenth `start` to `stop` of the log, with stamps shifted."""
    return [(topic, k / 10 + shift_s, k / 10 + 0.05) for k in range(start, stop) for topic in topics]


def stamps(recorded: Iterable[Recorded], topic: str) -> list[float]:
    return [round(stamp, 3) for name, stamp, _ in recorded if name == topic and stamp is not None]


def of(part: Iterable[tuple[str, float]], topic: str) -> list[float]:
    return [stamp for name, stamp in part if name == topic]


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 3000), st.integers(0, 900)), max_size=60),
    st.integers(-(10**7), 10**7),
)
def test_ordinary_disorder_passes_unchanged(arrivals: list[tuple[str, int, int]], apart_s: int) -> None:
    """Delays of up to 0.9 s, and clocks that are apart from the recorder's by any constant."""
    recorded = sorted(
        ((topic, at / 1000 + apart_s, (at + late) / 1000) for topic, at, late in arrivals), key=lambda one: one[2]
    )
    parts, drops, clocks = run(recorded)
    assert not drops
    assert not clocks.jumps
    assert len(parts) <= 1
    for topic in "abc":
        assert [of(part, topic) for part in parts] == ([stamps(recorded, topic)] if recorded else [])


@given(st.lists(st.tuples(st.sampled_from("abc"), st.one_of(st.none(), st.integers(-50, 50)), st.integers(0, 50))))
def test_every_message_comes_out_once_or_is_dropped_once(arrivals: list[tuple[str, int | None, int]]) -> None:
    """Whatever the stamps and log times are."""
    recorded: list[Recorded] = [(topic, stamp, log) for topic, stamp, log in arrivals]
    parts, drops, clocks = run(recorded)
    counts = Counter(topic for part in parts for topic, _ in part)
    counts.update(topic for topic, _, _ in drops)
    assert counts == Counter(topic for topic, _, _ in recorded)
    assert len(parts) <= len(clocks.jumps) + 1


def unexpected(drop: Drop) -> None:
    raise AssertionError(drop)


IMPOSSIBLE_NS = [-1, 2**31 * S, 2**63, 10**30]


@pytest.mark.parametrize("time_ns", IMPOSSIBLE_NS)
@pytest.mark.parametrize("at", [0, 9])
def test_what_cannot_be_a_time_is_bad_and_touches_nothing_else(time_ns: int, at: int) -> None:
    messages = [message(*one, position) for position, one in enumerate(steady("a", stop=20))]
    for changed, reason in (
        (messages[at]._replace(stamp_ns=time_ns), NO_TIME),
        (messages[at]._replace(log_time_ns=time_ns), NO_LOG_TIME),
    ):
        bad: list[Drop] = []
        clocks = Clocks({}, on_drop=unexpected, on_bad=bad.append)
        parts = [list(part) for part in clocks.parts([*messages[:at], changed, *messages[at + 1 :]])]
        assert parts == [[*messages[:at], *messages[at + 1 :]]]
        assert [drop.reason for drop in bad] == [reason]
        assert bad[0].detail.startswith("a: ")


@pytest.mark.parametrize("log_s", [0.5, 2.0])
def test_an_offset_does_not_take_a_stamp_before_1970(log_s: float) -> None:
    """Neither that of a message that was stamped in simulated time, nor that of one without a stamp."""
    bad: list[Drop] = []
    clocks = Clocks({"a": 3 * S}, on_drop=unexpected, on_bad=bad.append)
    assert [list(part) for part in clocks.parts([RawMessage(0, round(log_s * S), (0, 0), b"", CHANNELS["a"])])] == []
    assert [drop.reason for drop in bad] == [NO_TIME]


def test_a_first_stamp_ahead_of_its_recorder_waits_for_the_next() -> None:
    ahead = [("a", 2.1, 0.05), *steady("a", start=1)]
    parts, drops, clocks = run(ahead)
    assert drops == [("a", 2.1, OUTLIER)]
    assert not clocks.jumps
    assert [stamp for _, stamp in parts[0]] == stamps(steady("a", start=1), "a")


@pytest.mark.parametrize(
    ("place", "stamp_s", "reason"),
    [*((8, far_s, OUTLIER) for far_s in (-30.0, 1.5, 4e8)), *((row, None, ZERO) for row in (0, 8, 18))],
)
def test_one_wrong_stamp_is_dropped_alone(place: int, stamp_s: float | None, reason: str) -> None:
    recorded = steady()
    topic, _, log_s = recorded.pop(place)
    parts, drops, clocks = run([*recorded[:place], (topic, stamp_s, log_s), *recorded[place:]])
    assert drops == [("a", stamp_s or 0.0, reason)]
    assert not clocks.jumps
    assert not clocks.unstamped
    assert [sorted(part) for part in parts] == [sorted((t, s) for t, s, _ in recorded if s is not None)]


@pytest.mark.parametrize("count", [1, 10])
def test_a_topic_without_stamps_has_its_log_times(count: int) -> None:
    recorded = sorted([*steady("a"), *(("b", None, k / 10 + 0.07) for k in range(count))], key=lambda one: one[2])
    ((*part,),), drops, clocks = run(recorded, {"b": 20 * MS})
    assert of(part, "b") == [round(k / 10 + 0.05, 3) for k in range(count)]
    assert [*clocks.unstamped] == ["b"]
    assert not drops


LATE: list[Recorded] = [
    *(("a", k / 10, k / 10 + 0.05) for k in range(4)),
    *(("a", k / 10, 5 + k / 100) for k in range(4, 50)),  # what the recorder could not write, all at once
    *(("a", k / 10, k / 10 + (3 if k == 60 else 0.05)) for k in range(50, 61)),
]


@pytest.mark.parametrize(
    "recorded",
    [
        pytest.param(LATE, id="messages that are only recorded late"),
        pytest.param(
            [("a", 2.0 * k, 2.0 * k + delay_s) for k, delay_s in enumerate((3.0, 3.0, 3.0, 1.5, 2.5, 2.5))],
            id="a slow topic whose delay changes",
        ),
    ],
)
def test_what_is_sound_stays_in_one_part(recorded: list[Recorded]) -> None:
    ((*part,),), drops, clocks = run(recorded)
    assert of(part, "a") == stamps(recorded, "a")
    assert not drops
    assert not clocks.jumps


@pytest.mark.parametrize(
    ("stamp_s", "stalled"),
    [
        (lambda k: k / 10, 0),
        (lambda k: 5.0 + 0 * k, 29),  # set once
        (lambda k: k // 10, 27),  # without nanoseconds
        (lambda k: k // 10 + k % 10 / 1e4, 27),  # microseconds as nanoseconds
        (lambda k: k / 100, 0),  # a slow simulation
        (lambda k: k // 2 / 5, 15),  # two parts of a sweep
    ],
)
def test_stamps_that_hardly_advance_are_counted(stamp_s: Callable[[int], float], stalled: int) -> None:
    _, drops, clocks = run([("a", stamp_s(k), k / 10 + 0.05) for k in range(30)])
    assert clocks.stalled == ({"a": (stalled, 29)} if stalled else {})
    assert not drops


def test_a_recording_that_was_played_in_a_loop_is_split_at_each_turn() -> None:
    turns = [steady("abc", 30 * turn, 30 * (turn + 1), shift_s=-3.0 * turn) for turn in range(3)]
    parts, drops, clocks = run([one for turn in turns for one in turn])
    assert [sorted(part) for part in parts] == [sorted((t, round(s or 0, 3)) for t, s, _ in turn) for turn in turns]
    assert not drops
    assert clocks.jumps == [
        TimeJump("stamps", T0_S * S + 3_050 * MS, 3 * S),
        TimeJump("stamps", T0_S * S + 6_050 * MS, 3 * S),
    ]


@pytest.mark.parametrize("by_s", [-8.0, -2.0, 1.5, 3.0, 3600.0, 4e8])
@pytest.mark.parametrize(("topics", "late_s"), [("abc", 0.05), ("abc", 0.35), ("a", 0.05), ("ab", 0.05), ("c", 0.35)])
def test_a_clock_that_is_set_costs_only_what_is_near(topics: str, late_s: float, by_s: float) -> None:
    """If all stamps jump, a part begins; those of some topics go on with the others'. `c` may be recorded late."""
    recorded: list[Recorded] = []
    for k, topic in product(range(30), "abc"):
        log_s = k / 10 + (late_s if topic == "c" else 0.05)
        recorded.append((topic, k / 10 + by_s * (topic in topics and k >= 10), log_s))
    parts, drops, clocks = run(sorted(recorded, key=lambda one: one[2]))
    assert not drops
    steady_s = [k / 10 for k in range(30)]
    if topics == "abc":
        ((*before,), (*after,)) = parts
        for topic in "abc":
            begin = len(of(before, topic))
            assert of(before, topic) == steady_s[:begin]
            assert of(after, topic) == [round(k / 10 + by_s, 3) for k in range(begin, 30)]
            assert 10 <= begin <= 11 + round(10 * late_s)
        assert [(jump.kind, jump.topic) for jump in clocks.jumps] == [("stamps", "")]
    else:
        ((*part,),) = parts
        assert [of(part, topic) for topic in "abc"] == [steady_s] * 3
        assert [(jump.kind, jump.topic) for jump in clocks.jumps] == [("moved", topic) for topic in topics]
    assert all(round(-jump.by_ns / S, 3) == by_s for jump in clocks.jumps)


@pytest.mark.parametrize("by_s", [-8.0, 3.0, 3600.0])
def test_a_clock_that_is_set_and_set_back_leaves_no_trace(by_s: float) -> None:
    recorded = [(t, k / 10 + by_s * (t == "a" and 10 <= k < 20), k / 10 + 0.05) for k in range(30) for t in "ab"]
    ((*part,),), drops, clocks = run(recorded)
    assert [of(part, topic) for topic in "ab"] == [[k / 10 for k in range(30)]] * 2
    assert not drops
    assert [(jump.kind, jump.topic, jump.by_ns > 0) for jump in clocks.jumps] == [
        ("moved", "a", is_back) for is_back in (by_s < 0, by_s > 0)
    ]


@pytest.mark.parametrize("offset_s", [0, -4e8])
def test_a_clock_that_is_set_right_is_believed(offset_s: float) -> None:
    """It was recorded seconds late, or has an offset from before it was set, which a later part lacks."""
    wrong_s = offset_s or -3.0
    sent = [("b", k / 10 + (wrong_s if k < 10 else 0), k / 10 + 0.05) for k in range(20)]
    recorded = sorted([*steady("a", stop=20), *sent], key=lambda one: one[2])
    for begin in (0, 10):
        ((*part,),), drops, clocks = run(recorded[2 * begin :], {"b": round(offset_s * S)})
        assert of(part, "a") == [k / 10 for k in range(begin, 20)]
        assert of(part, "b") == [round(k / 10 + (wrong_s - offset_s if k < 10 else 0), 3) for k in range(begin, 20)]
        assert not drops
        assert [jump.kind for jump in clocks.jumps] == [] if begin else ["moved" if offset_s else "set"]


def test_log_times_that_jump_back_split_the_recording_at_once() -> None:
    first, second = steady("ab", 0, 30), steady("ab", 0, 20)
    parts, drops, clocks = run([*first, *second])
    assert [sorted(part) for part in parts] == [
        sorted((t, round(s or 0, 3)) for t, s, _ in turn) for turn in (first, second)
    ]
    assert not drops
    assert clocks.jumps == [TimeJump("log times", T0_S * S + 2_950 * MS, 2_900 * MS)]


@pytest.mark.parametrize(("begin_s", "dropped"), [(0.0, False), (-5.3, True)])
def test_simulated_time_begins_at_zero(begin_s: float, dropped: bool) -> None:
    """Stamps from 0 on while the recorder has the time of day; or a first stamp before the clock was read."""
    sent = [(0 if k == 0 else round((k / 10 - begin_s) * S), T0_S * S + round((k / 10 + 0.05) * S)) for k in range(5)]
    messages = [RawMessage(stamp, log, (0, k), b"", CHANNELS["a"]) for k, (stamp, log) in enumerate(sent)]
    drops, starts = list[Drop](), list[Drop]()
    clocks = Clocks({}, on_drop=drops.append, on_bad=drops.append, on_start=starts.append)
    found = [message.stamp_ns for part in clocks.parts(messages) for message in part]
    assert found == [stamp for stamp, _ in sent[dropped:]]
    assert [(drop.stamp_ns, drop.reason) for drop in starts] == [(0, ZERO)] * dropped
    assert not drops
    assert not clocks.unstamped
