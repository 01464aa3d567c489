"""Class numbers that no class has, and classes whose objects mostly fall below `min_score`."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d
from frames import CONFIG, frame

from lidcam.checks.boxes import DoubtedCheck, class_number_warnings
from lidcam.pipeline.core.detections import Fused, Hypotheses
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config

CAR, PEDESTRIAN = 0, 1
BOX = (5.0, 1.0, 0.5, 0.6, 0.6, 1.7, 0.0)


def seen(class_ids: list[int], beliefs: list[float], reported: list[int]) -> FrameResult:
    """A frame of boxes of these classes and probabilities, of which some are reported."""
    boxes, rows = boxes3d([BOX] * len(class_ids), class_ids=class_ids), np.array(reported, np.int64)
    fused = Fused(boxes.select(rows), np.zeros(len(rows), np.int32), rows)
    hypotheses = Hypotheses(boxes, {}, len(boxes))
    return replace(frame(), hypotheses=hypotheses, beliefs=np.array(beliefs, np.float64), fused=fused)


def told(
    frames: list[FrameResult], *, has_2d_boxes: bool = False, has_images: bool = True, min_score: float = 0.5
) -> list[str]:
    config = CONFIG.model_copy(update={"fuse": CONFIG.fuse.model_copy(update={"min_score": min_score})})
    check = DoubtedCheck(config, has_2d_boxes=has_2d_boxes, has_images=has_images)
    for one in frames:
        check.add_frame(one)
    return [str(warning) for warning in check.warnings]


def test_what_is_likely_and_hardly_reported_is_told() -> None:
    likely = [seen([CAR, PEDESTRIAN, PEDESTRIAN], [0.9, 0.3, 0.45], [0])] * 10
    (warning,) = told([*likely, seen([PEDESTRIAN], [0.8], [0])])
    assert warning == (
        "fuse.min_score: 20 pedestrian boxes score 0.2 to 0.5, below it; a 2D network (lidcam fetch, --model-2d "
        "FILE.onnx) tells which are right"
    )
    assert told(likely, has_2d_boxes=True) == []
    for min_score, lower in (0.5, "0.3"), (0.31, "0.3"), (0.3, "0.2"):
        (warning,) = told([seen([PEDESTRIAN], [0.25], [])] * 10, has_images=False, min_score=min_score)
        assert warning.endswith(f"; --set fuse.min_score={lower} reports more of them")


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param([], id="no frames"),
        pytest.param([seen([], [], [])], id="nothing"),
        pytest.param([seen([PEDESTRIAN], [0.3], [])] * 4, id="few"),
        pytest.param([seen([PEDESTRIAN], [0.1], [])] * 50, id="improbable"),
        pytest.param([seen([PEDESTRIAN], [0.3], [0])] * 50, id="reported all the same, as part of a track"),
        pytest.param([seen([CAR, CAR], [0.3, 0.9], [1])] * 50, id="a common class"),
    ],
)
def test_nothing_to_tell(frames: list[FrameResult]) -> None:
    assert told(frames) == []


@pytest.mark.parametrize(
    "unused",
    [{}, {"class 'tram' is not configured": 3}, {"score under detect2d.min_score (0.3)": 4}, {"class '-1' is not": 1}],
)
def test_names_are_no_numbers(unused: Mapping[str, int]) -> None:
    assert not [*class_number_warnings(unused, {}, Config())]


def test_numbers_that_no_class_has() -> None:
    unused = {"class '0' is not configured": 5, "class '7' is not configured": 2, "class 'tram' is not configured": 9}
    (warning,) = class_number_warnings(unused, {}, Config())
    assert str(warning) == (
        "recorded 2D boxes: 7 have unknown class numbers (0, 7); known are 1 car, 2 pedestrian, 3 bicycle, "
        "4 truck, 5 truck, 6 bus; if their detector numbers as COCO does (0 person, 2 car), "
        "--set detect2d.class_numbers=coco; or add these numbers to the labels of the classes"
    )


def test_long_lists_are_cut_and_there_may_be_no_numbers_among_the_labels() -> None:
    unused = {f"class '{n}' is not configured": 1 for n in range(20, 40)}
    config = load_config(None, {"classes": [{"name": "car", "size_m": [1, 1, 1], "max_size_m": [1, 1, 1]}]})
    (warning,) = class_number_warnings(unused, {}, config)
    assert warning.finding.endswith("(20, 21, 22, 23, 24, 25, 26, 27, 28, 29, ...); known are none")
    assert not [*class_number_warnings(unused, {}, load_config(None, {"detect2d.class_numbers": "coco"}))]


def test_numbers_of_3d_boxes() -> None:
    unused = {"class '9' is not configured": 2}
    (warning,) = class_number_warnings({}, unused, Config())
    assert str(warning).startswith("recorded 3D boxes: 2 have unknown class numbers (9); known are 1 car, ")
    assert "--set detect3d.recorded.class_numbers=autoware or =coco" in str(warning)
    assert len([*class_number_warnings(unused, unused, Config())]) == 2
    for numbers in ("coco", "autoware"):
        config = load_config(None, {"detect3d.recorded.class_numbers": numbers})
        assert not [*class_number_warnings({}, unused, config)]
