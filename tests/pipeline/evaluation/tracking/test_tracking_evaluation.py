from dataclasses import replace
from math import pi
from typing import Any

import pytest
from evaluation_frames import frame_of, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, TruthBoxes3D
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation

CAR, PEDESTRIAN = (4.0, 1.7, 1.5), (0.6, 0.6, 1.7)
ERRORS = ("misses", "false_positives", "id_switches", "fragmentations", "heading_flips")


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.8, *CAR, yaw]


def followed(frames: int = 10, *, yaws: tuple[float, ...] = (), tracks: tuple[int, ...] = ()) -> list[EvaluationFrame]:
    """One car that drives along x at 0.5 m a frame and is found where it is, under the given yaws and tracks."""
    return [
        frame_of(
            k,
            truth_boxes([car(0.5 * k)], [7]),
            {"fused": source_boxes([car(0.5 * k, 0.0, yaws[k] if yaws else 0.0)], [tracks[k] if tracks else 3])},
        )
        for k in range(frames)
    ]


def silent(frames: list[EvaluationFrame], *rows: int) -> list[EvaluationFrame]:
    """The same without a source in some frames."""
    return [replace(frame, sources={}) if row in rows else frame for row, frame in enumerate(frames)]


def tracking(frames: list[EvaluationFrame], config: Config | None = None) -> dict[str, Any]:
    evaluation = TrackingEvaluation(config or Config())
    for frame in frames:
        evaluation.add_frame(frame)
    figures: Any = evaluation.figures()
    sources: dict[str, Any] = figures["tracking"]
    return sources


def fused(frames: list[EvaluationFrame], config: Config | None = None, name: str = "car") -> dict[str, Any]:
    figures: dict[str, Any] = tracking(frames, config)["fused"][name]
    return figures


def errors(figures: dict[str, Any]) -> dict[str, int]:
    return {name: figures[name] for name in ERRORS if figures[name]}


def test_without_tracks_there_is_nothing() -> None:
    assert tracking([]) == {}
    assert tracking([frame_of(0, truth_boxes([car(0)], [1]), {"lidar": source_boxes([car(0)])})]) == {}
    assert tracking([frame_of(0, None, {"fused": source_boxes([car(0)], [1])})]) == {}


def test_truth_without_tracks_says_nothing_of_tracks() -> None:
    found = {"fused": source_boxes([car(0)], [1])}
    assert tracking([frame_of(0, truth_boxes([car(0)]), found)]) == {}
    # Where nothing is, nothing can be followed: that needs no tracks.
    assert errors(fused([frame_of(0, truth_boxes([]), found)])) == {"false_positives": 1}


def test_a_perfect_track() -> None:
    figures = fused(followed())
    assert errors(figures) == {}
    assert {figures[name] for name in ("hota", "det_a", "ass_a", "mota", "idf1")} == {1.0}
    assert figures["motp_m"] == 0
    assert (figures["truth_tracks"], figures["found_tracks"]) == (1, 1)
    assert figures["match_distance_m"] == 2


def test_flips_are_turns_that_the_object_does_not_make() -> None:
    assert errors(fused(followed(4, yaws=(0, pi, 0, 0)))) == {"heading_flips": 2}
    assert errors(fused(followed(4, yaws=(0, 1.5, 3.0, pi)))) == {}
    turning = [
        replace(frame, truth=truth_boxes([car(0.5 * k, 0, [0, pi, 0, 0][k])], [7]))
        for k, frame in enumerate(followed(4, yaws=(0, pi, 0, 0)))
    ]
    assert errors(fused(turning)) == {}


def test_false_tracks_are_those_that_mostly_match_nothing() -> None:
    """Track 1 is right, 2 is false in two of three frames, 3 in two of four, 4 in its only one."""
    rows = [{1: 0.0, 2: 30.0, 3: 60.0}, {1: 0.0, 2: 90.0, 3: 60.0}, {1: 0.0, 2: 90.0, 3: 75.0, 4: 200.0}, {3: 75.0}]
    frames = [
        frame_of(
            k,
            truth_boxes([car(0), car(30), car(60)], [7, 8, 9]),
            {"fused": source_boxes([car(x) for x in found.values()], [*found])},
        )
        for k, found in enumerate(rows)
    ]
    figures = fused(frames)
    assert (figures["found_tracks"], figures["false_tracks"]) == (4, 2)
    assert figures["false_track_s_mean"] == pytest.approx(0.2 / 2)
    assert fused(frames, name="all")["false_tracks"] == 2
    none = fused(followed())
    assert (none["false_tracks"], none["false_track_s_mean"]) == (0, None)


def test_classes_are_kept_apart_and_their_counts_summed() -> None:
    person = [20.0, 0, 0.9, *PEDESTRIAN, 0]
    frames = [
        frame_of(
            k,
            truth_boxes([car(0), person], [1, 1], class_ids=[0, 1]),
            {"fused": source_boxes([car(0), [0, 0, 0.9, *PEDESTRIAN, 0]], [1, 2], class_ids=[0, 1])},
        )
        for k in range(4)
    ]
    assert errors(fused(frames)) == {}
    assert errors(fused(frames, name="pedestrian")) == {"misses": 4, "false_positives": 4}
    total = fused(frames, name="all")
    assert errors(total) == {"misses": 4, "false_positives": 4}
    assert (total["mota"], total["idf1"], total["truth_tracks"]) == (0, 0.5, 2)
    assert total["match_distance_m"] is None


def seen(**counts: list[Any]) -> TruthBoxes3D:
    return truth_boxes([car(0), car(30)], [1, 2], **counts)


@pytest.mark.parametrize(
    "truth",
    [
        seen(lidar_points=[5, 0], image_pixels=[0, 0]),
        seen(is_ignored=[False, True]),
        seen(class_ids=[0, -1]),
        truth_boxes([car(0), car(30)], [1, -1]),
    ],
    ids=["unseen", "marked", "of no class", "without a track"],
)
def test_ignored_truth_is_neither_a_miss_nor_an_error(truth: TruthBoxes3D) -> None:
    missed = frame_of(0, truth, {"fused": source_boxes([car(0)], [1])})
    found = frame_of(1, truth, {"fused": source_boxes([car(0), car(31), car(29)], [1, 2, 3], class_ids=[0, 0, 0])})
    assert errors(fused([missed, found], name="all")) == {}
    other_class = frame_of(2, truth, {"fused": source_boxes([car(0), car(31)], [1, 2], class_ids=[0, 3])})
    assert errors(fused([other_class], name="all")) == {}
    elsewhere = frame_of(3, truth, {"fused": source_boxes([car(0), car(40)], [1, 2])})
    assert errors(fused([elsewhere], name="all")) == {"false_positives": 1}


def test_ignored_boxes_are_no_errors() -> None:
    frames = [
        frame_of(
            k,
            truth_boxes([car(0.5 * k)], [7]),
            {"fused": source_boxes([car(0.5 * k), car(30.0)], [3, 4], is_ignored=[True, True])},
        )
        for k in range(10)
    ]
    assert errors(fused(frames)) == {}, "one that shows an object that has to be found counts all the same"


def test_boxes_without_a_track_of_their_own_do_not_count() -> None:
    found = source_boxes([car(0), car(0.1), car(20), car(60)], [1, 1, -1, 2], scores=[0.5, 0.9, 0.5, 0.5])
    figures = fused([frame_of(0, truth_boxes([car(0)], [1]), {"fused": found})])
    assert figures["motp_m"] == pytest.approx(0.1)  # of two boxes of one track that with the higher score counts
    assert errors(figures) == {"false_positives": 1}


def test_long_recordings_are_those_of_all_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = silent(followed(30, tracks=(3,) * 13 + (4,) * 17), 20)
    whole = tracking(frames)
    monkeypatch.setattr("lidcam.pipeline.evaluation.tracking.collect.BLOCK_FRAMES", 7)
    assert tracking(frames) == whole
    assert errors(whole["fused"]["car"]) == {"misses": 1, "fragmentations": 1, "id_switches": 1}
