from math import pi
from typing import Any

import pytest
from evaluation_frames import frame_of, source_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes
from lidcam.pipeline.evaluation.unlabelled import UnlabelledEvaluation

CAR_SIZE_M = (4.0, 1.7, 1.5)
TRUCK_ID = 3


def car(x: float, yaw: float = 0.0) -> list[float]:
    return [x, 0.0, 0.8, *CAR_SIZE_M, yaw]


def figures(frames: list[EvaluationFrame], config: Config | None = None) -> Any:
    evaluation = UnlabelledEvaluation(config or Config())
    for frame in frames:
        evaluation.add_frame(frame)
    return evaluation.figures()


def frames_of(*found: SourceBoxes) -> list[EvaluationFrame]:
    return [frame_of(k, None, {"fused": boxes}) for k, boxes in enumerate(found)]


def chains(*found: SourceBoxes) -> Any:
    return figures(frames_of(*found))["unlabelled"]["fused"]["chains"]


def test_nothing_at_all() -> None:
    assert figures([]) == {"unlabelled": {}, "sync": {"skew_mean_ms": None, "skew_max_ms": None}}
    none: Any = {"chains": 0, "flickers": 0, "class_changes": 0, "heading_flips": 0}
    none |= {"seconds_mean": None, "missing_share": None}
    assert chains(source_boxes([]), source_boxes([])) == none
    assert chains(source_boxes([car(0)])) == none, "objects without tracks have no chains"


@pytest.mark.parametrize(
    ("missing", "flickers", "missing_share"),
    [((), 0, 0), ((6, 7, 12), 2, 3 / 20), (tuple(range(6, 11)), 1, 5 / 20), (tuple(range(6, 12)), 0, 6 / 20)],
)
def test_who_vanishes_for_a_while_flickers(missing: tuple[int, ...], flickers: int, missing_share: float) -> None:
    found = chains(*(source_boxes([], []) if k in missing else source_boxes([car(k)], [7]) for k in range(20)))
    assert (found["chains"], found["flickers"]) == (1, flickers)
    assert found["missing_share"] == pytest.approx(missing_share)
    assert found["seconds_mean"] == pytest.approx(1.9)


def test_a_chain_ends_where_time_goes_back() -> None:
    stamps_ns = (0, 10**8, 0, 10**8)
    frames = [
        frame_of(k, None, {"fused": source_boxes([car(0)], [7])}, stamp_ns=stamp) for k, stamp in enumerate(stamps_ns)
    ]
    assert figures(frames)["unlabelled"]["fused"]["chains"]["chains"] == 2


def test_tracks_are_told_apart_and_changes_counted() -> None:
    boxes = [source_boxes([car(k), car(50), car(9)], [5, 6, -1]) for k in range(12)]
    boxes[4] = source_boxes([car(4, pi), car(50)], [5, 6])
    boxes[8] = source_boxes([car(50), car(8)], [6, 5], class_ids=[0, TRUCK_ID])
    found = chains(*boxes)
    assert (found["chains"], found["heading_flips"], found["class_changes"]) == (2, 2, 2)


def test_only_the_region_counts() -> None:
    config = Config(evaluate=EvaluateConfig(max_range_m=10))
    frames = frames_of(source_boxes([car(5), car(15)], [1, 2]), source_boxes([]))
    tree = figures(frames, config)["unlabelled"]["fused"]
    assert (tree["objects"]["per_frame_mean"], tree["chains"]["chains"]) == (0.5, 1)


def test_skews() -> None:
    frames = [frame_of(k, None, {}, skew_ns=ns) for k, ns in enumerate([1_000_000, 2_000_000, None, 9_000_000])]
    assert figures(frames)["sync"] == {"skew_mean_ms": 4, "skew_max_ms": 9}
