from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, boxes3d
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior
from lidcam.pipeline.evaluation.comparison import differences as module
from lidcam.pipeline.evaluation.comparison.comparison import MAX_APART_NS, Comparison, paired_frames
from lidcam.pipeline.evaluation.comparison.differences import Channel
from lidcam.pipeline.evaluation.comparison.object_changes import KINDS, Kind
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, ResultFrame, SourceBoxes

MS = 1_000_000
Pairs = list[tuple[int | None, int | None]]
Row = tuple[float, float, float, float, float, float, float]

CAR, PEDESTRIAN, BICYCLE = 0, 1, 2
CHANNELS: tuple[Channel, ...] = (("sources", "fused"), ("images", "cam"))
CARS: tuple[Row, Row] = ((10, 5, 0.8, 4.2, 1.8, 1.5, 0.3), (-10, -5, 0.8, 4.2, 1.8, 1.5, -0.3))


def objects(
    *rows: Row,
    class_ids: Sequence[int] | None = None,
    scores: Sequence[float] | None = None,
    ids: Sequence[int] | None = None,
) -> SourceBoxes:
    """Objects of one source from rows x, y, z, length, width, height, yaw."""
    track_ids = [UNKNOWN] * len(rows) if ids is None else ids
    return SourceBoxes(boxes3d(rows, class_ids=class_ids, scores=scores), np.array(track_ids, np.int64))


def run_of(count: int, found: SourceBoxes, *, camera: Boxes2D | None = None) -> list[ResultFrame]:
    """Frames in which nothing moves, from 1 s on."""
    cameras = {"cam": boxes2d([(10, 10, 50, 40, 0.9, 0)]) if camera is None else camera}
    frame = ResultFrame(0, 10**9, 10**9, {"fused": found}, cameras)
    return [replace(frame, index=index, stamp_ns=10**9 + index * 100_000_000) for index in range(count)]


def compared(
    first: list[ResultFrame],
    second: list[ResultFrame],
    *,
    classes: tuple[ClassPrior, ...] = ROAD_CLASSES,
    allowed: tuple[Kind, ...] = (),
) -> Comparison:
    found = Comparison(ROAD_CLASSES, classes, CHANNELS, allowed)
    for pair in paired_frames(first, second):
        found.add_pair(pair)
    found.close()
    return found


def figures(first: list[ResultFrame], second: list[ResultFrame]) -> Any:
    return compared(first, second).figures()


def kinds_of(counts: dict[str, Any]) -> dict[str, int]:
    return {kind: counts[kind] for kind in KINDS if counts[kind]}


def changed_in(frames: list[ResultFrame], rows: range, found: SourceBoxes) -> list[ResultFrame]:
    return [replace(frame, sources={"fused": found}) if frame.index in rows else frame for frame in frames]


CLOSE = st.tuples(
    *[st.sampled_from([0.0, 0.3, 5.0])] * 2,
    st.just(0.8),
    *[st.sampled_from([0.0, 1.0, 4.0])] * 3,
    st.sampled_from([0.0, np.pi]),
)


@given(rows=st.lists(CLOSE, max_size=8), seed=st.integers(0, 9))
@settings(derandomize=True)
def test_objects_on_top_of_each_other_differ_in_nothing_from_themselves(rows: list[Row], seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = objects(
        *rows,
        class_ids=rng.integers(0, 3, len(rows)).tolist(),
        scores=rng.choice([0.2, 0.9], len(rows)).tolist(),
        ids=rng.integers(-1, 3, len(rows)).tolist(),
    )
    flat = boxes2d([(x, y, x + length, y + width, 0.5, 0) for x, y, _, length, width, _, _ in rows])
    order = rng.permutation(len(rows))
    first, second = run_of(2, found, camera=flat), run_of(2, found.select(order), camera=flat.select(order))
    tree = figures(first, second)
    assert set(kinds_of(tree["sources"]["fused"]["all"])) <= {"reidentified"}
    assert not kinds_of(tree["images"]["cam"]["all"])


@pytest.mark.parametrize(
    ("row", "changes", "kinds"),
    [
        pytest.param((0.009, 0, 0, 0, 0, 0, 0), {}, set(), id="moved a little"),
        pytest.param((0.3, 0.4, 0, 0, 0, 0, 0), {}, {"moved"}, id="moved"),
        pytest.param((0, 0, 0, 0, 0, 0, np.radians(5)), {}, {"turned"}, id="turned"),
        pytest.param((0, 0, 0, 0, 0, 0, 2 * np.pi), {}, set(), id="turned all the way"),
        pytest.param((0, 0, 0, 0, 0.2, 0, 0), {}, {"resized"}, id="wider"),
        pytest.param((0, 0, 0, 0, 0, 0, 0), {"class_ids": [BICYCLE, CAR]}, {"relabelled"}, id="relabelled"),
        pytest.param((0, 0, 0, 0, 0, 0, 0), {"scores": [0.8, 0.5]}, {"rescored"}, id="rescored"),
        pytest.param(
            (0.5, 0, 0, 0.3, 0, 0, 0.2),
            {"class_ids": [BICYCLE, CAR], "scores": [0.1, 0.5]},
            {"moved", "turned", "resized", "relabelled", "rescored"},
            id="all of it",
        ),
        pytest.param((3.9, 0, 0, 0, 0, 0, 0), {}, {"moved"}, id="moved nearly as far as it may"),
        pytest.param((4.1, 0, 0, 0, 0, 0, 0), {}, {"lost", "new"}, id="moved farther"),
    ],
)
def test_how_an_object_differs(row: Row, changes: dict[str, Any], kinds: set[str]) -> None:
    there: Any = tuple(float(a + b) for a, b in zip(CARS[0], row, strict=True))
    tree = figures(run_of(1, objects(*CARS)), run_of(1, objects(there, CARS[1], **changes)))
    counts = tree["sources"]["fused"]["all"]
    assert kinds_of(counts) == dict.fromkeys(kinds, 1)
    assert counts["different"] == (2 if "lost" in kinds else bool(kinds))
    assert counts["equal"] == (2 if not kinds else 1)
    assert tree["frames_different"] == bool(kinds)


def test_what_is_told_of_an_object_that_differs_for_a_while() -> None:
    run = run_of(12, objects(*CARS))
    turned = objects(CARS[0], (*CARS[1][:6], CARS[1][6] + np.radians(5)))
    more = objects(CARS[0], (*CARS[1][:6], CARS[1][6] - np.radians(7)), class_ids=[CAR, BICYCLE])
    second = changed_in(changed_in(run, range(3, 6), turned), range(6, 8), more)
    tree = figures(run, second)
    (told,) = tree["differences"]["listed"]
    assert (told["source"], told["class"], told["new_class"]) == ("fused", "car", "bicycle")
    assert (told["frames"], told["first_frame"], told["last_frame"]) == (5, 3, 7)
    assert (told["first_s"], told["last_s"], told["first_stamp_ns"]) == (0.3, 0.7, 1_300_000_000)
    assert told["place"] == list(CARS[1][:3])
    assert told["kinds"]["turned"] == {"frames": 5, "largest": pytest.approx(7)}
    assert told["kinds"]["relabelled"] == {"frames": 2, "largest": None}
    assert tree["sources"]["fused"]["car"]["turned"] == 5


def test_a_difference_that_goes_away_and_comes_back_is_two() -> None:
    run = run_of(9, objects(*CARS))
    without = objects(CARS[0])
    second = changed_in(changed_in(run, range(1, 3), without), range(3, 5), objects())
    second = changed_in(second, range(7, 8), without)
    told = figures(run, second)["differences"]["listed"]
    places = [(one["place"][0], one["first_frame"], one["frames"]) for one in told]
    assert places == [(-10, 1, 4), (10, 3, 2), (-10, 7, 1)]


def test_a_difference_ends_where_a_frame_is_missing() -> None:
    run = run_of(6, objects(*CARS))
    without = changed_in(run, range(6), objects(CARS[0]))
    tree = figures(run, [*without[:2], *without[3:]])
    assert [(told["first_frame"], told["frames"]) for told in tree["differences"]["listed"]] == [(0, 2), (3, 3)]
    names = "frames", "frames_different", "frames_only_in_a", "frames_only_in_b"
    assert [tree[name] for name in names] == [5, 5, 1, 0]
    assert tree["sources"]["fused"]["all"]["a"] == 10, "objects of frames that one result alone has do not count"


def test_tracks_that_swap_their_ids_are_told_once() -> None:
    run = run_of(6, objects(*CARS, ids=[1, 2]))
    swapped = changed_in(run, range(3, 6), objects(*CARS, ids=[2, 1]))
    tree = figures(run, swapped)
    assert kinds_of(tree["sources"]["fused"]["all"]) == {"reidentified": 2}
    assert [told["first_frame"] for told in tree["differences"]["listed"]] == [3, 3]
    renamed = run_of(6, objects(*CARS, ids=[7, 9]))
    fused = figures(run, renamed)["sources"]["fused"]["all"]
    assert not kinds_of(fused), "other ids for the same tracks are no change"


def test_boxes_of_images() -> None:
    rows = [(0, 0, 40, 40, 0.9, 0), (100, 0, 140, 40, 0.9, 0)], [(0, 0, 43, 40, 0.8, 1), (120, 0, 160, 40, 0.9, 0)]
    first, second = (run_of(1, objects(), camera=boxes2d(one)) for one in rows)
    counts = figures(first, second)["images"]["cam"]["all"]
    assert kinds_of(counts) == {"moved": 2, "relabelled": 1, "rescored": 1}
    assert counts["largest_moved_px"] == 20
    assert "largest_turned_deg" not in counts
    away = run_of(1, objects(), camera=boxes2d([(0, 0, 43, 40, 0.8, 1), (125, 0, 165, 40, 0.9, 0)]))  # IoU 0.23
    apart = figures(first, away)["images"]["cam"]["all"]
    assert kinds_of(apart) == {"lost": 1, "new": 1, "moved": 1, "relabelled": 1, "rescored": 1}


def test_what_differs_by_just_as_much_as_it_may_is_equal() -> None:
    first = run_of(1, objects(*CARS, scores=[0.1, 0.7]), camera=boxes2d([(600.1, 7, 640, 40, 0.2, 0)]))
    second = run_of(1, objects(*CARS, scores=[0.11, 0.69]), camera=boxes2d([(601.1, 7, 641, 40, 0.21, 0)]))
    tree = figures(first, second)
    assert not tree["differences"]["count"]


def test_classes_are_compared_by_name() -> None:
    others = (ROAD_CLASSES[1], ROAD_CLASSES[0].model_copy(update={"name": "automobile"}), ROAD_CLASSES[0])
    found = objects(*CARS, class_ids=[CAR, CAR])
    as_named = compared(run_of(1, found), run_of(1, objects(*CARS, class_ids=[2, 1])), classes=others)
    assert as_named.class_names == ("car", "pedestrian", "bicycle", "truck", "bus", "automobile")
    (told,) = (told for told in as_named.figures()["differences"]["listed"] if "source" in told)
    assert (told["class"], told["new_class"]) == ("car", "automobile")


@pytest.mark.parametrize(
    ("allowed", "share"), [((), 50.0), (("turned",), 0.0), (("lost",), 50.0), (("turned", "moved"), 0.0)]
)
def test_share_of_what_is_not_allowed(allowed: tuple[Kind, ...], share: float) -> None:
    run = run_of(4, objects(*CARS))
    second = changed_in(run, range(4), objects(CARS[0], (*CARS[1][:6], 0.5)))
    found = compared(run, second, allowed=allowed)
    assert found.not_allowed_percent(frames_may_differ=False) == {"frames": 0.0, "fused": share, "cam": 0.0}
    assert found.figures()["sources"]["fused"]["car"]["different_percent"] == 50.0


def test_only_the_earliest_differences_are_kept_and_all_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_LISTED", 3)
    run = run_of(40, objects(*CARS))
    second = [frame if frame.index % 2 else replace(frame, sources={"fused": objects(CARS[0])}) for frame in run]
    found = figures(run, second)["differences"]
    assert found["count"] == 20
    assert [told["first_frame"] for told in found["listed"]] == [0, 2, 4]


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
