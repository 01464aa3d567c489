"""Every layout against a direct reading of the same numbers, one row at a time, through a whole detector."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from onnx_networks import FLOAT16, write_convolutional, write_network

from lidcam.pipeline.core.arrays import U8, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx.detector import OnnxDetector2D

SIZE_PX = (64, 96)
CELLS = 8 * 12 + 4 * 6 + 2 * 3
RNG = np.random.default_rng(7)
NAMES = "{0: 'car', 1: \"driver's mate\", 2: 'dog', 3: 'tram'}"

Read = Callable[[Mapping[str, Array], int], tuple[float, float, float, float, float, int] | None]


class Case(NamedTuple):
    """A network, and a direct reading of one row as xyxy in pixels of the input, score, class; None for no object."""

    layout: str
    outputs: Mapping[str, Array]
    read: Read
    placement: str = "center"
    scaled: tuple[str, ...] = ()


def boxes(count: int) -> Array:
    """Centre and size in pixels of the input."""
    return np.concatenate([RNG.uniform(0, 96, (count, 2)), RNG.uniform(1, 60, (count, 2))], 1)


def xyxy(count: int) -> Array:
    corner = RNG.uniform(0, 60, (count, 2))
    return np.concatenate([corner, corner + RNG.uniform(1, 40, (count, 2))], 1)


def scores(count: int, columns: int) -> Array:
    return RNG.uniform(0, 1, (count, columns))


def from_center(cx: float, cy: float, w: float, h: float) -> tuple[float, float, float, float]:
    return cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2


def largest(values: Array) -> tuple[float, int]:
    best = max(range(len(values)), key=lambda c: float(values[c]))
    return float(values[best]), best


def with_objectness(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    cx, cy, w, h, objectness, *classes = outputs["output0"][row].tolist()
    score, label = largest(np.array(classes))
    return (*from_center(cx, cy, w, h), objectness * score, label)


def of_columns(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    cx, cy, w, h, *classes = outputs["output0"][:, row].tolist()
    return (*from_center(cx, cy, w, h), *largest(np.array(classes)))


def listed(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int] | None:
    left, top, right, bottom, score, label = outputs["output0"][row].tolist()
    return (left, top, right, bottom, score, int(label)) if score > 0 else None


def in_shares(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    cx, cy, w, h, *classes = outputs["output0"][row].tolist()
    return (*from_center(cx * 96, cy * 64, w * 96, h * 64), *largest(np.array(classes)))


def listed_in_shares(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    cx, cy, w, h, score, label = outputs["output0"][row].tolist()
    return (*from_center(cx * 96, cy * 64, w * 96, h * 64), score, int(label))


def of_logits(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    box = next(array for name, array in outputs.items() if array.shape[1] == 4 and ("box" in name or name == "dets"))
    logits = next(array for array in outputs.values() if array is not box)
    cx, cy, w, h = box[row].tolist()
    score, label = largest(logits[row])
    return (*from_center(cx * 96, cy * 64, w * 96, h * 64), 1 / (1 + math.exp(-score)), label)


def sized(outputs: Mapping[str, Array], row: int) -> tuple[float, float, float, float, float, int]:
    left, top, right, bottom = outputs["boxes"][row].tolist()
    return (left * 96, top * 64, right * 96, bottom * 64, float(outputs["scores"][row]), int(outputs["labels"][row]))


def f32(*parts: Array) -> Array:
    return np.concatenate(parts, 1).astype(np.float32)


def shares(count: int) -> Array:
    return np.concatenate([RNG.uniform(0, 1, (count, 2)), RNG.uniform(0.01, 0.5, (count, 2))], 1)


CASES = {
    "YOLOX": Case("yolox", {"output0": f32(boxes(CELLS), scores(CELLS, 5))}, with_objectness, "top_left"),
    "YOLOv5": Case("yolov5", {"output0": f32(boxes(3 * CELLS), scores(3 * CELLS, 5))}, with_objectness),
    "YOLOv5 with a fourth grid": Case(
        "yolov5", {"output0": f32(boxes(3 * CELLS + 3), scores(3 * CELLS + 3, 5))}, with_objectness
    ),
    "YOLOv8": Case("yolov8", {"output0": f32(boxes(CELLS), scores(CELLS, 4)).T.copy()}, of_columns),
    "YOLOv8 with a finer grid": Case(
        "yolov8", {"output0": f32(boxes(CELLS + 384), scores(CELLS + 384, 4)).T.copy()}, of_columns
    ),
    "end to end": Case(
        "end_to_end",
        {"output0": f32(xyxy(50), RNG.permutation(np.linspace(0, 1, 50))[:, None], RNG.integers(0, 4, (50, 1)))},
        listed,
    ),
    "RT-DETR of Ultralytics": Case("rtdetr", {"output0": f32(shares(40), scores(40, 4))}, in_shares, "stretched"),
    "RT-DETR of Ultralytics, listed": Case(
        "rtdetr",
        {"output0": f32(shares(40), RNG.uniform(0.01, 1, (40, 1)), RNG.integers(0, 4, (40, 1)))},
        listed_in_shares,
        "stretched",
    ),
    "RT-DETR of Transformers": Case(
        "detr",
        {"logits": f32(RNG.normal(-3, 3, (40, 4))), "pred_boxes": f32(shares(40))},
        of_logits,
        "stretched",
    ),
    "RF-DETR": Case(
        "detr", {"dets": f32(shares(40)), "labels": f32(RNG.normal(0, 3, (40, 4)))}, of_logits, "stretched"
    ),
    "D-FINE": Case(
        "dfine",
        {
            "labels": RNG.integers(0, 4, 40),
            "boxes": f32(shares(40)),
            "scores": RNG.uniform(0.01, 1, 40).astype(np.float32),
        },
        sized,
        "stretched",
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


def read_directly(case: Case, image_px: tuple[int, int]) -> tuple[Array, Array, list[int]]:
    """Boxes in pixels of the image, scores and classes of all objects."""
    scale_x, scale_y, left_px, top_px = placed(case, image_px)
    first = next(iter(case.outputs.values()))
    count = first.shape[1] if case.layout == "yolov8" else len(first)
    rows = [found for row in range(count) if (found := case.read(case.outputs, row)) is not None]
    corners = [
        ((x0 - left_px) / scale_x, (y0 - top_px) / scale_y, (x1 - left_px) / scale_x, (y1 - top_px) / scale_y)
        for x0, y0, x1, y1, *_ in rows
    ]
    return np.array(corners), np.array([row[4] for row in rows]), [row[5] for row in rows]


def load(path: Path, **settings: object) -> OnnxDetector2D:
    """A network of which every box is wanted unless the settings say otherwise."""
    return OnnxDetector2D(path, Detect2DConfig.model_validate({"min_score": 0.0, **settings}))


def written(folder: Path, outputs: Mapping[str, Array], **options: Any) -> Path:
    return write_network(folder / "m.onnx", outputs, size_px=SIZE_PX, metadata={"names": NAMES}, **options)


@pytest.mark.parametrize("min_score", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_what_scores_enough_is_the_same_where_the_rest_may_be_left_out(
    tmp_path: Path, case: Case, min_score: float
) -> None:
    path = written(tmp_path, case.outputs, scaled=case.scaled)
    (every,) = load(path, input=(96, 64))([picture(375, 1242)])
    (some,) = load(path, input=(96, 64), min_score=min_score)([picture(375, 1242)])
    expected, found = every.scores >= min_score, some.scores >= min_score
    np.testing.assert_array_equal(some.xyxy[found], every.xyxy[expected])
    np.testing.assert_array_equal(some.scores[found], every.scores[expected])
    np.testing.assert_array_equal(some.labels[found], every.labels[expected])


def picture(height: int, width: int) -> U8:
    return np.zeros((height, width, 3), np.uint8)


@pytest.mark.parametrize("image_px", [(64, 96), (375, 1242), (480, 640), (600, 100), (10, 12)])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_layout_is_read_as_directly(tmp_path: Path, case: Case, image_px: tuple[int, int]) -> None:
    model = load(written(tmp_path, case.outputs, scaled=case.scaled), input=(96, 64))
    assert model.labels == ("car", "driver's mate", "dog", "tram")
    (found,) = model([picture(*image_px)])
    expected_xyxy, expected_scores, expected_labels = read_directly(case, image_px)
    scale_x, scale_y, _, _ = placed(case, image_px)
    np.testing.assert_allclose(found.xyxy * min(scale_x, scale_y), expected_xyxy * min(scale_x, scale_y), atol=1e-3)
    np.testing.assert_allclose(found.scores, expected_scores, atol=1e-6)
    assert found.labels.tolist() == expected_labels
    assert found.xyxy.dtype == found.scores.dtype == np.float32
    assert found.labels.dtype == np.int64


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_half_precision(tmp_path: Path, case: Case) -> None:
    halved = {name: a if a.dtype == np.int64 else a.astype(np.float16) for name, a in case.outputs.items()}
    (found,) = load(written(tmp_path, halved, dtype=FLOAT16, scaled=case.scaled))([picture(*SIZE_PX)])
    expected_xyxy, expected_scores, _ = read_directly(case, SIZE_PX)
    np.testing.assert_allclose(found.xyxy, expected_xyxy, atol=0.2)
    np.testing.assert_allclose(found.scores, expected_scores, atol=2e-3)


@pytest.mark.parametrize("layout", ["yolov5", "yolov8", "rtdetr"])
def test_networks_other_than_yolox_see_white_as_1(tmp_path: Path, layout: str) -> None:
    shape = {"yolov5": (3 * CELLS, 9), "yolov8": (8, CELLS), "rtdetr": (40, 8)}[layout]
    array, weight = np.full(shape, 0.5), np.zeros(shape)
    scored = (slice(4, None), slice(None)) if layout == "yolov8" else (slice(None), slice(4, None))
    array[scored], weight[scored] = 0, 1
    if layout == "yolov5":
        array[:, 4], weight[:, 4] = 1, 0
    path = written(tmp_path, {"output0": array.astype(np.float32)}, weights={"output0": weight})
    (found,) = load(path)([np.full((*SIZE_PX, 3), 51, np.uint8)])
    np.testing.assert_allclose(found.scores, 0.2, rtol=1e-4)


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
        load(path)([picture(*SIZE_PX)])


def test_numbers_that_are_too_large(tmp_path: Path) -> None:
    path = written(tmp_path, {"output0": np.full((8, CELLS), 3e38, np.float32)})
    assert len(load(path)([picture(*SIZE_PX)])) == 1


def test_rows_without_a_score_are_filling(tmp_path: Path) -> None:
    (found,) = load(written(tmp_path, {"output0": np.array([[0, 0, 0, 0, 0, -1]] * 5, np.float32)}))(
        [picture(*SIZE_PX)]
    )
    assert len(found.scores) == 0


@pytest.mark.parametrize("size_px", [(64, 96), (160, 224), (320, 64)])
def test_a_convolutional_network_sees_a_larger_picture_as_it_is(tmp_path: Path, size_px: tuple[int, int]) -> None:
    """Cell by cell: a convolution with the stride of its cells is a sum over the cell's pixels."""
    strides, columns = (8, 16, 32), 85
    kernels = [RNG.normal(0, 1e-4, (columns, 3, stride, stride)) for stride in strides]
    biases = [RNG.uniform(0, 1, columns) for _ in strides]
    model = load(write_convolutional(tmp_path / "m.onnx", kernels, biases, size_px=SIZE_PX))
    image = RNG.integers(0, 256, (*size_px, 3), np.uint8)
    (found,) = model([image])
    corners, best, row = [], [], image[..., ::-1].transpose(2, 0, 1).astype(np.float64)
    for stride, kernel, bias in zip(strides, kernels, biases, strict=True):
        for top in range(0, size_px[0], stride):
            for left in range(0, size_px[1], stride):
                cell = row[:, top : top + stride, left : left + stride]
                values = [float((kernel[c] * cell).sum() + bias[c]) for c in range(columns)]
                if values[4] < 0:
                    continue
                cx, cy = left + values[0] * stride, top + values[1] * stride
                corners.append(from_center(cx, cy, math.exp(values[2]) * stride, math.exp(values[3]) * stride))
                best.append(values[4] * max(values[5:]))
    np.testing.assert_allclose(found.xyxy, corners, atol=1e-3)
    np.testing.assert_allclose(found.scores, best, atol=1e-4)
