"""Which messages make a set, and which join one: against the genuine programs, rules that both keep, cases by hand."""

import itertools
import json
import random
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any

import pytest
from helpers import shared
from hypothesis import example, given
from hypothesis import strategies as st

from lidcam.pipeline.stages.sync.approximate_time import ApproximateTime
from lidcam.pipeline.stages.sync.drop_reason import DropReason
from lidcam.pipeline.stages.sync.nearest import NearestPartners

MS = 1_000_000

Item = tuple[int, int, int]  # topic, stamp_ns, number of the arrival
Arrival = tuple[int, int]  # topic, stamp_ns
Drops = list[tuple[Item, str]]


Sets = list[tuple[Item, ...]]


class Joined:
    """Items of all other topics join those of topic 0; used as `ApproximateTime`."""

    def __init__(self, topic_count: int, queue_size: int, slop_ns: int, on_drop: Callable[[Item, str], None]) -> None:
        self._partners: NearestPartners[Item, Item] = NearestPartners(
            topic_count,
            queue_size=queue_size,
            max_references=queue_size,
            slop_ns=slop_ns,
            on_drop=on_drop,
            on_reference_drop=on_drop,
        )
        self._partners.wait_for(range(1, topic_count))

    def add_item(self, topic: int, stamp_ns: int, item: Item) -> Sets:
        if topic == 0:
            return self._sets(self._partners.add_reference(stamp_ns, item))
        return self._sets(self._partners.add_item(topic, stamp_ns, item))

    def flush(self) -> Sets:
        return self._sets(self._partners.flush())

    def close(self) -> None:
        self._partners.close()

    def _sets(self, resolved: list[tuple[Item, dict[int, Item]]]) -> Sets:
        return [(item, *partners.values()) for item, partners in resolved]


Finder = ApproximateTime[Item] | Joined
both = pytest.mark.parametrize("kind", [ApproximateTime, Joined])


def make_finder(
    kind: type[Finder], topic_count: int = 2, *, queue_size: int = 10, slop_ms: int = 50, drops: Drops | None = None
) -> Finder:
    def on_drop(item: Item, reason: str) -> None:
        if drops is not None:
            drops.append((item, reason))

    if kind is Joined:
        return Joined(topic_count, queue_size, slop_ms * MS, on_drop)
    return ApproximateTime(topic_count, queue_size=queue_size, max_interval_ns=slop_ms * MS, on_drop=on_drop)


def found_live(policy: Finder, arrivals: Iterable[Arrival]) -> list[Sequence[tuple[Item, ...]]]:
    """The sets that each arrival brings about."""
    return [policy.add_item(topic, stamp_ns, (topic, stamp_ns, n)) for n, (topic, stamp_ns) in enumerate(arrivals)]


def run_finder(policy: Finder, arrivals: Iterable[Arrival]) -> list[tuple[Item, ...]]:
    sets = [*itertools.chain(*found_live(policy, arrivals)), *policy.flush()]
    policy.close()
    return sets


def stamps_ms(sets: Iterable[tuple[Item, ...]]) -> list[list[int]]:
    return [[stamp_ns // MS for _, stamp_ns, _ in found] for found in sets]


def arrivals_ms(*arrivals: tuple[int, int]) -> list[Arrival]:
    return [(topic, stamp_ms * MS) for topic, stamp_ms in arrivals]


# --- the genuine programs


@cache
def oracle_cases() -> dict[str, dict[str, Any]]:
    cases = json.loads(shared("oracles/sync/cases.json").read_text())
    return {case["name"]: case for case in cases}


@pytest.mark.parametrize("variant", ["default", "maxint"])
def test_equals_genuine_message_filters(variant: str) -> None:
    assert len(oracle_cases()) == 51
    for name, case in oracle_cases().items():
        expected = case["expected_cpp"][variant]
        dropped: list[list[int]] = []
        policy: ApproximateTime[list[int]] = ApproximateTime(
            case["topics"],
            queue_size=case["queue_size"],
            max_interval_ns=None if variant == "default" else round(case["slop"] * 1e9),
            on_drop=lambda item, _, dropped=dropped: dropped.append(item),  # type: ignore[misc]  # bound at once
        )
        found = []
        for arrival, (topic, stamp_ns, message_id) in enumerate(case["arrivals"]):
            found += [
                [arrival, list(messages)] for messages in policy.add_item(topic, stamp_ns, [stamp_ns, message_id])
            ]
        policy.close()
        assert found == expected, name
        assert len(dropped) + case["topics"] * len(found) == len(case["arrivals"]), name


# --- both


streams = st.lists(st.tuples(st.integers(0, 2), st.integers(0, 400)), max_size=60).map(
    lambda pairs: arrivals_ms(*pairs)
)  # unsorted, with equal stamps
sorted_streams = streams.map(lambda arrivals: sorted(arrivals, key=lambda arrival: arrival[1]))
any_stream = st.one_of(streams, sorted_streams)


@both
@given(arrivals=any_stream, queue_size=st.integers(1, 6), slop_ms=st.integers(0, 150))
def test_every_message_is_used_once_or_dropped_once_and_few_wait(
    kind: type[Finder], arrivals: list[Arrival], queue_size: int, slop_ms: int
) -> None:
    drops: Drops = []
    policy = make_finder(kind, 3, queue_size=queue_size, slop_ms=slop_ms, drops=drops)
    sets: list[tuple[Item, ...]] = []
    arrived = [(topic, stamp_ns, number) for number, (topic, stamp_ns) in enumerate(arrivals)]
    for topic, stamp_ns, number in arrived:
        sets += policy.add_item(topic, stamp_ns, (topic, stamp_ns, number))
        held = Counter(topic for topic, _ in arrivals[: number + 1])
        held.subtract(topic for topic, _, _ in [*itertools.chain(*sets), *(item for item, _ in drops)])
        assert all(0 <= count <= queue_size for count in held.values())
    sets += policy.flush()
    policy.close()
    assert sorted([*itertools.chain(*sets), *(item for item, _ in drops)]) == sorted(arrived)
    topics = {tuple(topic for topic, _, _ in found) for found in sets}
    assert topics <= {(0, 1, 2)} if kind is ApproximateTime else all(found[0] == 0 for found in topics)
    assert all(reason for _, reason in drops)


@both
@given(arrivals=sorted_streams, slop_ms=st.integers(0, 150), seed=st.integers(0, 2**32))
@example([*[(0, 0)] * 10, (1, 0), (1, 0), (2, 0), (0, MS), (2, MS)], 1, 0)
def test_interleaving_of_topics_does_not_matter(
    kind: type[Finder], arrivals: list[Arrival], slop_ms: int, seed: int
) -> None:
    by_topic: dict[int, list[Arrival]] = defaultdict(list)
    for arrival in arrivals:
        by_topic[arrival[0]].append(arrival)
    shuffled_topics = [topic for topic, _ in arrivals]
    random.Random(seed).shuffle(shuffled_topics)
    shuffled = [by_topic[topic].pop(0) for topic in shuffled_topics]

    def result(stream: list[Arrival]) -> list[list[int]]:
        return stamps_ms(run_finder(make_finder(kind, 3, queue_size=99, slop_ms=slop_ms), stream))

    assert result(shuffled) == result(arrivals)


# --- approximate_time


@pytest.mark.parametrize(
    ("arrivals", "live", "flushed"),
    [
        ([(0, 0), (1, 10), (0, 100), (1, 110)], [[0, 10]], [[100, 110]]),
        # A third message of the first topic at 38 would make a better set than (33, 38).
        ([(0, 33), (0, 33), (1, 38), (1, 44)], [], [[33, 38], [33, 44]]),
    ],
)
def test_approximate_time_flushes_what_the_end_makes_certain(
    arrivals: list[Arrival], live: list[list[int]], flushed: list[list[int]]
) -> None:
    policy = make_finder(ApproximateTime)
    assert stamps_ms(itertools.chain(*found_live(policy, arrivals_ms(*arrivals)))) == live
    assert stamps_ms(policy.flush()) == flushed
    assert policy.flush() == []


@pytest.mark.parametrize(
    ("arrivals", "queue_size", "expected"),
    [
        ([(0, 0), (1, 90)], 10, [(0, DropReason.TOO_FAR), (90, DropReason.END)]),
        ([(0, 0), (0, 100)], 1, [(0, DropReason.QUEUE_FULL), (100, DropReason.END)]),
        # (0, 40) is a candidate until (40, 41), with the same pivot, proves better.
        ([(0, 0), (1, 40), (0, 41), (1, 42)], 10, [(0, DropReason.LEFT_OUT), (42, DropReason.END)]),
        # The lost message of topic 0 might have been the partner of 49, nearer than 90.
        ([(0, 50), (0, 90), (1, 49)], 1, [(50, DropReason.QUEUE_FULL), (49, DropReason.AFTER_OVERFLOW)]),
    ],
)
def test_approximate_time_reasons(
    arrivals: list[Arrival], queue_size: int, expected: list[tuple[int, DropReason]]
) -> None:
    drops: Drops = []
    run_finder(make_finder(ApproximateTime, queue_size=queue_size, drops=drops), arrivals_ms(*arrivals))
    assert [(item[1] // MS, reason) for item, reason in drops][: len(expected)] == expected


# --- joined


@pytest.mark.parametrize(
    ("arrivals", "expected"),
    [
        ([], []),
        ([(0, 0)], [[0]]),
        ([(0, 0), (1, 50)], [[0, 50]]),  # slop is inclusive
        ([(0, 0), (1, 51)], [[0]]),
        ([(0, 100), (1, 90), (1, 110)], [[100, 90]]),  # a tie goes to the earlier stamp
        ([(1, 110), (0, 100), (1, 90)], [[100, 90]]),  # whatever arrived first
        ([(0, 0), (1, 10), (1, 20), (0, 100), (1, 70), (1, 95)], [[0, 10], [100, 95]]),
        ([(0, 0), (0, 50), (1, 40), (1, 140)], [[0], [50, 40]]),  # wanted by two: goes to the nearer
        ([(0, 0), (0, 50), (1, 25), (1, 140)], [[0, 25], [50]]),  # equally near: to the earlier
        ([(0, 0), (0, 50), (1, 40), (1, 51)], [[0, 40], [50, 51]]),  # the nearer one has a nearer partner
        ([(0, 0), (0, 40), (1, 30), (1, 45)], [[0, 30], [40, 45]]),  # the same, further from both
        ([(0, 100), (0, 0), (1, 98), (1, 2), (1, 200)], [[0, 2], [100, 98]]),  # out of order, in time
    ],
)
def test_what_joins(arrivals: list[tuple[int, int]], expected: list[list[int]]) -> None:
    assert stamps_ms(run_finder(make_finder(Joined), arrivals_ms(*arrivals))) == expected


@pytest.mark.parametrize(
    ("topics", "queue_size", "arrivals", "emitted"),
    [
        pytest.param(
            3,
            10,
            [(0, 0), (1, 1), (2, 2), (0, 100), (1, 101), (2, 99), (2, 140)],
            [[], [], [], [], [], [], [[0, 1, 2]]],
            id="every topic has reached the next reference",
        ),
        pytest.param(
            2, 10, [(0, 0), (1, 101), (1, 3), (0, 100)], [[], [], [], [[0, 3]]], id="had reached it, out of order"
        ),
        pytest.param(
            2, 3, [(0, 0), (1, -10), (1, 20), (1, 40), (1, 60)], [[], [], [], [], [[0, -10]]], id="a queue is full"
        ),
    ],
)
def test_when_a_set_is_complete(
    topics: int, queue_size: int, arrivals: list[tuple[int, int]], emitted: list[list[list[int]]]
) -> None:
    found = found_live(make_finder(Joined, topics, queue_size=queue_size), arrivals_ms(*arrivals))
    assert [stamps_ms(sets) for sets in found] == emitted


def test_reasons_of_what_joins_nothing() -> None:
    drops: Drops = []
    finder = make_finder(Joined, 3, drops=drops)
    stream = [(0, 0), (1, 30), (1, 3), (2, 4), (2, 5), (0, 300), (1, 100), (1, 301), (2, 400), (0, 500), (1, 500)]
    stream += [(2, 500), (0, 1), (0, 900), (1, 900), (2, 900), (1, 2)]
    assert stamps_ms(run_finder(finder, arrivals_ms(*stream))) == [
        [0, 3, 4],
        [300, 301],
        [500, 500, 500],
        [900, 900, 900],
    ]
    assert [(item[0], item[1] // MS, reason) for item, reason in drops] == [
        (1, 30, DropReason.NO_REFERENCE),
        (1, 100, DropReason.NO_REFERENCE),
        (2, 5, DropReason.NO_REFERENCE),
        (2, 400, DropReason.NO_REFERENCE),
        (0, 1, DropReason.TOO_LATE),
        (1, 2, DropReason.TOO_LATE),
    ]
