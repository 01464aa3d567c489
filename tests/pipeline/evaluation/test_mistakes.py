from typing import Any

import numpy as np
from evaluation_frames import frame_of, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, TruthBoxes3D
from lidcam.pipeline.evaluation.mistakes import Mistakes

CONFIG = Config()
TRUCK = 3
NONE: Any = {"mistakes": {"fused": {"false": [], "missed": []}}}
SIZE = (4.0, 1.7, 1.5)


def row(x: float, y: float = 0.0) -> tuple[float, ...]:
    return (x, y, 0.75, *SIZE, 0.0)


def truth(*places: float, ids: list[int] | None = None, points: list[int] | None = None) -> TruthBoxes3D:
    return truth_boxes([row(x) for x in places], ids or list(range(len(places))), lidar_points=points)


def collected(*frames: EvaluationFrame) -> Mistakes:
    mistakes = Mistakes(CONFIG)
    for frame in frames:
        mistakes.add_frame(frame)
    return mistakes


def frame(
    index: int,
    true: TruthBoxes3D | None,
    *found: float,
    scores: list[float] | None = None,
    class_ids: list[int] | None = None,
) -> EvaluationFrame:
    boxes = source_boxes([row(x) for x in found], scores=scores, class_ids=class_ids)
    return frame_of(index, true, {"fused": boxes})


def test_what_is_right_is_no_mistake() -> None:
    mistakes = collected(frame(0, truth(0, 10), 0.5, 10.0), frame(1, truth(0, 10), 10.0, 0.0))
    assert mistakes.figures() == NONE


def test_without_frames_truth_or_source_there_is_none() -> None:
    assert collected().figures() == NONE
    assert collected(frame(0, None, 3.0)).figures() == NONE
    assert collected(frame_of(0, truth(1), {})).worst("missed", 3) == []


def test_a_bench_taken_for_a_car_in_many_frames_is_one_mistake() -> None:
    scores = [0.2, 0.8, 0.3]
    mistakes = collected(*(frame(n, truth(), 20.0 + 0.2 * n, scores=[score]) for n, score in enumerate(scores)))
    (bench,) = mistakes.worst("false", 10)
    assert (bench.frames, bench.worst_ns, bench.first_ns, bench.last_ns) == (3, 100_000_000, 0, 200_000_000)
    assert (bench.named["class"], bench.named["label"], bench.track_id) == ("car", None, -1)
    assert np.isclose([bench.severity, bench.weight, bench.center[0]], [0.8, 1.3, 20.2]).all()


def test_misses_of_one_object_are_one_mistake_wherever_it_drives() -> None:
    frames = [frame(n, truth(50.0 * n, ids=[7], points=[10 + n])) for n in range(4)]
    (miss,) = collected(*frames).worst("missed", 10)
    assert (miss.frames, miss.track_id, miss.named["label"]) == (4, 7, "any")
    assert (miss.severity, miss.worst_ns) == (13, 300_000_000)
    assert collected(*frames).worst("false", 10) == []


def test_a_false_detection_names_the_object_at_its_place() -> None:
    second = collected(frame(0, truth(0, ids=[4]), 0.0, 1.0, scores=[0.9, 0.8])).worst("false", 10)
    assert [(one.named["cause"], one.track_id, one.named["label"]) for one in second] == [("second", 4, "any")]
    other = collected(frame(0, truth(0, ids=[4]), 0.0, class_ids=[TRUCK]))
    (false,), (missed,) = other.worst("false", 10), other.worst("missed", 10)
    assert (false.named, false.track_id) == ({"class": "truck", "label": "any", "cause": "class"}, 4)
    assert missed.named == {"class": "car", "label": "any", "cause": None}
    misplaced = collected(frame(0, truth(0, ids=[4]), 2.5)).worst("false", 10)
    assert [(one.named["cause"], one.track_id) for one in misplaced] == [("place", 4)]


def test_what_is_ignored_is_neither_missed_nor_false() -> None:
    true = truth_boxes([row(0), row(20)], [0, 1], is_ignored=[True, False], lidar_points=[9, 0], image_pixels=[9, 0])
    assert collected(frame(0, true, 0.0)).figures() == NONE


def test_figures_are_plain_values() -> None:
    told: Any = collected(frame(2, truth()), frame(3, truth(60.0, points=[12]), 20.0)).figures()
    both: dict[str, Any] = {"class": "car", "frames": 1, "worst_frame": 3, "worst_ns": 300_000_000}
    both |= {"first_s": 0.1, "last_s": 0.1, "worst_s": 0.1, "y_m": 0.0, "z_m": 0.75, "yaw_deg": 0.0}
    both |= {"length_m": 4.0, "width_m": 1.7, "height_m": 1.5}
    assert told["mistakes"]["fused"] == {
        "false": [both | {"label": None, "cause": "nothing", "x_m": 20.0, "score": 0.5, "lidar_points": None}],
        "missed": [both | {"label": "any", "cause": None, "x_m": 60.0, "score": None, "lidar_points": 12}],
    }
