"""Layouts by names and shapes; and each against a direct reading of the same numbers through a whole detector."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from onnx_files import write_convolutional, write_network

from lidcam.pipeline.core.arrays import U8, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig, NetworkLayout
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D
from lidcam.pipeline.detectors.onnx.layouts import Layout, Trial, recognise

SIZE_PX = (64, 96)
CELLS = 8 * 12 + 4 * 6 + 2 * 3
RNG = np.random.default_rng(7)
NAMES = "{0: 'car', 1: \"driver's mate\", 2: 'dog', 3: 'tram'}"

PX = np.array([96, 64, 96, 64])


class Case(NamedTuple):
    """A network, and a direct reading of it as xyxy in pixels of the input, scores and classes of all objects."""

    layout: str
    outputs: Mapping[str, Array]
    read: Callable[[Mapping[str, Array]], tuple[Array, Array, Array]]
    placement: str = "stretched"
    scaled: tuple[str, ...] = ()


def boxes(count: int, most: float = 96.0) -> Array:
    """Centre and size in pixels of the input, or in shares of it."""
    return np.concatenate([RNG.uniform(0, most, (count, 2)), RNG.uniform(most / 96, most / 2, (count, 2))], 1)


def scores(count: int, columns: int) -> Array:
    return RNG.uniform(0.01, 1, (count, columns))


def f32(*parts: Array) -> Array:
    return np.concatenate(parts, 1).astype(np.float32)


def around(rows: Array) -> Array:
    """xyxy of centre and size."""
    return np.concatenate([rows[:, :2] - rows[:, 2:4] / 2, rows[:, :2] + rows[:, 2:4] / 2], 1)


def largest(xyxy: Array, of_classes: Array) -> tuple[Array, Array, Array]:
    return xyxy, of_classes.max(1), of_classes.argmax(1)


def with_objectness(outputs: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    rows = outputs["output0"]
    return largest(around(rows), rows[:, 4:5] * rows[:, 5:])


def of_logits(boxes: str, logits: str) -> Callable[[Mapping[str, Array]], tuple[Array, Array, Array]]:
    return lambda outputs: largest(around(outputs[boxes]) * PX, 1 / (1 + np.exp(-outputs[logits].astype(np.float64))))


def listed(outputs: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    rows = outputs["output0"]
    return rows[:, :4], rows[:, 4], rows[:, 5]


NUMBERED = RNG.integers(0, 4, (50, 1))
CASES = {
    "YOLOX": Case("yolox", {"output0": f32(boxes(CELLS), scores(CELLS, 5))}, with_objectness, "top_left"),
    "YOLOv5": Case("yolov5", {"output0": f32(boxes(3 * CELLS), scores(3 * CELLS, 5))}, with_objectness, "center"),
    "YOLOv8": Case(
        "yolov8",
        {"output0": f32(boxes(CELLS), scores(CELLS, 4)).T.copy()},
        lambda outputs: largest(around(outputs["output0"].T), outputs["output0"].T[:, 4:]),
        "center",
    ),
    "end to end": Case(
        "end_to_end",
        {"output0": f32(around(boxes(50)) + 60, RNG.permutation(scores(50, 1)), NUMBERED)},
        listed,
        "center",
    ),
    "RT-DETR of Ultralytics": Case(
        "rtdetr",
        {"output0": f32(boxes(40, 1.0), scores(40, 4))},
        lambda outputs: largest(around(outputs["output0"]) * PX, outputs["output0"][:, 4:]),
    ),
    "RT-DETR of Ultralytics, listed": Case(
        "rtdetr",
        {"output0": f32(boxes(50, 1.0), scores(50, 1), NUMBERED)},
        lambda outputs: (around(outputs["output0"]) * PX, *listed(outputs)[1:]),
    ),
    "RT-DETR of Transformers": Case(
        "detr",
        {"logits": f32(RNG.normal(-3, 3, (40, 4))), "pred_boxes": f32(boxes(40, 1.0))},
        of_logits("pred_boxes", "logits"),
    ),
    "RF-DETR": Case(
        "detr", {"dets": f32(boxes(40, 1.0)), "labels": f32(RNG.normal(0, 3, (40, 4)))}, of_logits("dets", "labels")
    ),
    "D-FINE": Case(
        "dfine",
        {"labels": NUMBERED[:, 0], "boxes": f32(around(boxes(50, 1.0))), "scores": f32(scores(50, 1))[:, 0]},
        lambda outputs: (outputs["boxes"] * PX, outputs["scores"], outputs["labels"]),
        scaled=("boxes",),
    ),
}


def placed(case: Case, image_px: tuple[int, int]) -> tuple[float, float, float, float]:
    """Scale and offset of an image (height, width) in the input, in x and y."""
    height, width = image_px
    if case.placement == "stretched":
        return 96 / width, 64 / height, 0.0, 0.0
    ratio = min(96 / width, 64 / height)
    if case.placement == "top_left":
        return int(width * ratio) / width, int(height * ratio) / height, 0.0, 0.0
    columns, rows = round(width * ratio), round(height * ratio)
    return columns / width, rows / height, round((96 - columns) / 2 - 0.1), round((64 - rows) / 2 - 0.1)


def read_directly(case: Case, image_px: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Boxes in pixels of the image, scores and classes of all objects."""
    xyxy, found, labels = case.read({name: array.astype(np.float64) for name, array in case.outputs.items()})
    *scale, left_px, top_px = placed(case, image_px)
    return (xyxy - [left_px, top_px] * 2) / (scale * 2), found, labels


def load(path: Path, **settings: object) -> OnnxDetector2D:
    """A network of which every box is wanted unless the settings say otherwise."""
    return OnnxDetector2D(path, Detect2DConfig.model_validate({"min_score": 0.0, **settings}))


def written(folder: Path, outputs: Mapping[str, Array], **options: Any) -> Path:
    return write_network(folder / "m.onnx", outputs, size_px=SIZE_PX, metadata={"names": NAMES}, **options)


def image(height: int, width: int) -> U8:
    return np.zeros((height, width, 3), np.uint8)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_layout_is_read_as_directly(tmp_path: Path, case: Case) -> None:
    """Also where boxes below a score may be left out."""
    path = written(tmp_path, case.outputs, scaled=case.scaled)
    model = load(path, input=(96, 64))
    assert model.labels == ("car", "driver's mate", "dog", "tram")
    for image_px in ((64, 96), (480, 640), (600, 100), (10, 12), (375, 1242)):
        (found,) = model([image(*image_px)])
        expected_xyxy, expected_scores, expected_labels = read_directly(case, image_px)
        scale = min(placed(case, image_px)[:2])
        np.testing.assert_allclose(found.xyxy * scale, expected_xyxy * scale, atol=1e-3)
        np.testing.assert_allclose(found.scores, expected_scores, atol=1e-6)
        assert found.labels.tolist() == expected_labels.tolist()
        assert found.xyxy.dtype == found.scores.dtype == np.float32
        assert found.labels.dtype == np.int64
    (some,) = load(path, input=(96, 64), min_score=0.5)([image(375, 1242)])
    rows, full_rows = some.scores >= 0.5, found.scores >= 0.5
    np.testing.assert_array_equal(some.xyxy[rows], found.xyxy[full_rows])
    np.testing.assert_array_equal(some.labels[rows], found.labels[full_rows])


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_half_precision(tmp_path: Path, case: Case) -> None:
    halved = {name: a if a.dtype == np.int64 else a.astype(np.float16) for name, a in case.outputs.items()}
    (found,) = load(written(tmp_path, halved, kind="float16", scaled=case.scaled))([image(*SIZE_PX)])
    expected_xyxy, expected_scores, _ = read_directly(case, SIZE_PX)
    np.testing.assert_allclose(found.xyxy, expected_xyxy, atol=0.2)
    np.testing.assert_allclose(found.scores, expected_scores, atol=2e-3)


@pytest.mark.parametrize(
    ("label", "fault"),
    [
        (9, r"finds the class 9, and there are names for 4: set detect2d\.names"),
        *((label, "expected numbers of classes, found") for label in (-1, 0.5, 3e9)),
    ],
)
def test_what_is_no_class(tmp_path: Path, label: float, fault: str) -> None:
    path = written(tmp_path, {"output0": np.array([[1, 2, 30, 40, 0.5, label]], np.float32)})
    with pytest.raises(ModelError, match=fault):
        load(path)([image(*SIZE_PX)])


@pytest.mark.parametrize(
    ("rows", "count"),
    [
        pytest.param(np.full((8, CELLS), 3e38), CELLS, id="numbers that are too large"),
        pytest.param(np.array([[0, 0, 0, 0, 0, -1]] * 5), 0, id="rows without a score are filling"),
    ],
)
def test_odd_outputs(tmp_path: Path, rows: Array, count: int) -> None:
    (found,) = load(written(tmp_path, {"output0": rows.astype(np.float32)}))([image(*SIZE_PX)])
    assert len(found.scores) == count


@pytest.mark.parametrize("size_px", [(64, 96), (160, 224)])
def test_a_convolutional_network_sees_a_larger_image_as_it_is(tmp_path: Path, size_px: tuple[int, int]) -> None:
    """Cell by cell: a convolution with the stride of its cells is a sum over the cell's pixels."""
    strides, columns = (8, 16, 32), 85
    kernels = [RNG.normal(0, 1e-4, (columns, 3, stride, stride)) for stride in strides]
    biases = [RNG.uniform(0, 1, columns) for _ in strides]
    model = load(write_convolutional(tmp_path / "m.onnx", kernels, biases, size_px=SIZE_PX))
    rgb = RNG.integers(0, 256, (*size_px, 3), np.uint8)
    (found,) = model([rgb])
    corners, best, row = [], [], rgb[..., ::-1].transpose(2, 0, 1).astype(np.float64)
    for stride, kernel, bias in zip(strides, kernels, biases, strict=True):
        for top in range(0, size_px[0], stride):
            for left in range(0, size_px[1], stride):
                cell = row[:, top : top + stride, left : left + stride]
                values = [float((kernel[c] * cell).sum() + bias[c]) for c in range(columns)]
                if values[4] < 0:
                    continue
                cx, cy = left + values[0] * stride, top + values[1] * stride
                corners.append((cx, cy, math.exp(values[2]) * stride, math.exp(values[3]) * stride))
                best.append(values[4] * max(values[5:]))
    np.testing.assert_allclose(found.xyxy, around(np.array(corners)), atol=1e-3)
    np.testing.assert_allclose(found.scores, best, atol=1e-4)


# --- recognition


def blank(*shape: int, value: float = 0.5) -> Array:
    return np.full((1, *shape), value, np.float32)


def found_layout(
    *outputs: Array, names: str = "", takes_sizes: bool = False, wanted: NetworkLayout | None = None
) -> Layout:
    named = names.split() or [f"output{row}" for row in range(len(outputs))]
    return recognise(Trial((640, 640), named, outputs, takes_sizes), wanted)


@pytest.mark.parametrize(
    ("outputs", "names", "expected"),
    [
        ([blank(8400, 85)], "", ("yolox", 80, "bgr_255", "top_left")),
        ([blank(8400, 6)], "", ("yolox", 1, "bgr_255", "top_left")),
        ([blank(8400, 85, value=1.0)], "", ("yolov5", 80, "rgb_1", "center")),
        ([blank(8500, 85, value=1.0)], "", ("yolov5", 80, "rgb_1", "center")),  # YOLOv6 with grids up to stride 64
        ([blank(3 * 8500, 13)], "", ("yolov5", 8, "rgb_1", "center")),
        ([blank(84, 8400)], "", ("yolov8", 80, "rgb_1", "center")),
        ([blank(5, 8400)], "", ("yolov8", 1, "rgb_1", "center")),
        ([blank(14, 8400 + 160 * 160)], "", ("yolov8", 10, "rgb_1", "center")),
        ([blank(84, 2000)], "", ("yolov8", 80, "rgb_1", "center")),  # YOLOv3-tiny of Ultralytics
        ([blank(3 * 2000, 13)], "", ("yolov5", 8, "rgb_1", "center")),
        ([blank(300, 6, value=30.0)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(300, 6, value=0.0)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(0, 6)], "", ("end_to_end", None, "rgb_1", "center")),
        ([blank(300, 6, value=1.0)], "", ("rtdetr", None, "rgb_1", "stretched")),
        ([blank(300, 6, value=0.5)], "", ("rtdetr", 2, "rgb_1", "stretched")),
        ([blank(300, 84)], "", ("rtdetr", 80, "rgb_1", "stretched")),
        ([blank(300, 80), blank(300, 4)], "logits pred_boxes", ("detr", 80, "rgb_1", "stretched")),
        ([blank(300, 4), blank(300, 4)], "pred_logits pred_boxes", ("detr", 4, "rgb_1", "stretched")),
        ([blank(300, 4), blank(300, 91)], "dets labels", ("detr", 91, "imagenet", "stretched")),
    ],
)
def test_recognised_by_names_and_shapes(
    outputs: list[Array], names: str, expected: tuple[str, int | None, str, str]
) -> None:
    layout = found_layout(*outputs, names=names)
    assert (layout.name, layout.class_count, layout.colors, layout.placement) == expected


@pytest.mark.parametrize("names", ["labels boxes scores", "scores labels boxes"])
def test_labels_boxes_and_scores_in_any_order(names: str) -> None:
    arrays = {"labels": blank(300), "boxes": blank(300, 4), "scores": blank(300)}
    layout = found_layout(*(arrays[name] for name in names.split()), names=names, takes_sizes=True)
    assert (layout.name, layout.class_count) == ("dfine", None)


@pytest.mark.parametrize(
    ("outputs", "names", "takes_sizes"),
    [
        ([], "", False),
        ([blank()], "", False),
        ([blank(8400, 4)], "", False),
        ([blank(300, 84, value=300.0)], "", False),
        ([blank(84, 8399, value=5.0)], "", False),
        ([blank(116, 8400), blank(32, 160, 160)], "", False),
        ([blank(8400, 4, value=300.0), blank(8400, 80)], "boxes scores", False),
        ([blank(300, 4), blank(300, 4)], "a b", False),
        ([blank(300, 4), blank(299, 80)], "boxes scores", False),
        ([blank(300), blank(300, 4), blank(300)], "labels boxes scores", False),
        ([blank(300), blank(300, 4), blank(300)], "labels boxes labels2", True),
    ],
)
def test_unknown_layouts(outputs: list[Array], names: str, takes_sizes: bool) -> None:
    with pytest.raises(ModelError, match=r"expected outputs of a known layout: YOLOX .* for 640 x 640 px"):
        found_layout(*outputs, names=names, takes_sizes=takes_sizes)


def test_the_settings_prevail() -> None:
    assert found_layout(blank(8400, 85), wanted="yolov5").placement == "center"
    assert found_layout(blank(300, 6), wanted="rtdetr").class_count == 2
    with pytest.raises(ModelError, match=r"expected outputs of the layout yolox; found output0 \(1, 300, 4\)"):
        found_layout(blank(300, 4), wanted="yolox")
