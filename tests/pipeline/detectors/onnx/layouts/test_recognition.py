import numpy as np
import pytest

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import NetworkLayout
from lidcam.pipeline.detectors.onnx.layouts import Layout, Trial, recognise

SIZE_PX = (640, 640)
CELLS = 8400


def blank(*shape: int, value: float = 0.5) -> Array:
    return np.full((1, *shape), value, np.float32)


def found(*outputs: Array, names: str = "", takes_sizes: bool = False, wanted: NetworkLayout | None = None) -> Layout:
    given = names.split() or [f"output{row}" for row in range(len(outputs))]
    return recognise(Trial(SIZE_PX, given, outputs, takes_sizes), wanted)


@pytest.mark.parametrize(
    ("outputs", "names", "expected"),
    [
        ([blank(CELLS, 85)], "", ("yolox", 80, "bgr_255", "top_left")),
        ([blank(CELLS, 6)], "", ("yolox", 1, "bgr_255", "top_left")),
        ([blank(CELLS, 85, value=1.0)], "", ("yolov5", 80, "rgb_1", "center")),
        ([blank(3 * CELLS, 85)], "", ("yolov5", 80, "rgb_1", "center")),
        ([blank(3 * (CELLS + 100), 13)], "", ("yolov5", 8, "rgb_1", "center")),
        ([blank(84, CELLS)], "", ("yolov8", 80, "rgb_1", "center")),
        ([blank(5, CELLS)], "", ("yolov8", 1, "rgb_1", "center")),
        ([blank(6, CELLS)], "", ("yolov8", 2, "rgb_1", "center")),
        ([blank(14, CELLS + 160 * 160)], "", ("yolov8", 10, "rgb_1", "center")),
        ([blank(300, 6, value=30.0)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(300, 6, value=0.0)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(300, 6, value=1.0)], "", ("rtdetr", None, "rgb_1", "stretched")),
        ([blank(300, 6, value=0.5)], "", ("rtdetr", 2, "rgb_1", "stretched")),
        ([blank(0, 6)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(300, 84)], "", ("rtdetr", 80, "rgb_1", "stretched")),
        ([blank(300, 369)], "", ("rtdetr", 365, "rgb_1", "stretched")),
        ([blank(300, 80), blank(300, 4)], "logits pred_boxes", ("detr", 80, "rgb_1", "stretched")),
        ([blank(300, 4), blank(300, 4)], "pred_logits pred_boxes", ("detr", 4, "rgb_1", "stretched")),
        ([blank(300, 4), blank(300, 4)], "dets labels", ("detr", 4, "imagenet", "stretched")),
        ([blank(300, 4), blank(300, 91)], "dets labels", ("detr", 91, "imagenet", "stretched")),
    ],
)
def test_told_by_names_and_shapes(outputs: list[Array], names: str, expected: tuple[str, int | None, str, str]) -> None:
    layout = found(*outputs, names=names)
    assert (layout.name, layout.class_count, layout.colors, layout.placement) == expected


def test_labels_boxes_and_scores_in_any_order() -> None:
    arrays = {"labels": blank(300), "boxes": blank(300, 4), "scores": blank(300)}
    for names in ("labels boxes scores", "scores labels boxes"):
        layout = found(*(arrays[name] for name in names.split()), names=names, takes_sizes=True)
        assert (layout.name, layout.class_count) == ("dfine", None)


@pytest.mark.parametrize(
    ("outputs", "names"),
    [
        ([], ""),
        ([blank(CELLS, 4)], ""),
        ([blank(300, 84, value=300.0)], ""),
        ([blank(84, 8399, value=5.0)], ""),
        ([blank(116, CELLS), blank(32, 160, 160)], ""),
        ([blank(CELLS, 4, value=300.0), blank(CELLS, 80)], "boxes scores"),
        ([blank(300, 4), blank(300, 4)], "a b"),
        ([blank(300, 4), blank(299, 80)], "boxes scores"),
        ([blank(300), blank(300, 4), blank(300)], "labels boxes scores"),
        ([blank()], ""),
    ],
)
def test_what_nothing_is_known_of(outputs: list[Array], names: str) -> None:
    with pytest.raises(ModelError, match=r"expected outputs of a known layout: YOLOX .* for 640 x 640 px"):
        found(*outputs, names=names)


def test_sizes_as_an_input_and_other_outputs() -> None:
    with pytest.raises(ModelError, match="known layout"):
        found(blank(300), blank(300, 4), blank(300), names="labels boxes labels2", takes_sizes=True)


def test_the_settings_prevail() -> None:
    assert found(blank(CELLS, 85), wanted="yolov5").placement == "center"
    assert found(blank(300, 6), wanted="rtdetr").class_count == 2
    with pytest.raises(ModelError, match=r"expected outputs of the layout yolox; found output0 \(1, 300, 4\)"):
        found(blank(300, 4), wanted="yolox")
