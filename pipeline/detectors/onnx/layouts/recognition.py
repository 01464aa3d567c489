"""Which layout a network has, by its inputs, its outputs for blank images, and what its file says of itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import NetworkColors, NetworkLayout
from lidcam.pipeline.detectors.onnx.layouts.cells import (
    STRIDES_PX,
    YoloV5Reader,
    YoloV8Reader,
    YoloxReader,
    cell_count,
    is_in_pixels,
)
from lidcam.pipeline.detectors.onnx.layouts.layout import Layout, Size
from lidcam.pipeline.detectors.onnx.layouts.queries import (
    DetrReader,
    DfineReader,
    EndToEndReader,
    RtDetrListReader,
    RtDetrReader,
)

PYRAMIDS_PX = (STRIDES_PX, (8, 16, 32, 64), (4, 8, 16, 32))
"""Strides of the grids of YOLO networks; the usual ones first."""

ANCHORS_PER_CELL = 3
"""Of YOLOv5 and YOLOv7."""

KNOWN = (
    "YOLOX (N, A, 5 + C), YOLOv5 (N, 3 A, 5 + C), YOLOv8 (N, 4 + C, A), end-to-end (N, K, 6), RT-DETR (N, Q, 4 + C), "
    "boxes (N, Q, 4) and scores (N, Q, C), or labels, boxes and scores"
)


@dataclass(frozen=True, slots=True)
class Trial:
    """Outputs of a network for blank images.

    Attributes:
        size_px: Height and width of its input.
        names: Names of its outputs.
        outputs: Its outputs.
        takes_sizes: Whether it has a second input for the sizes of the images.
    """

    size_px: Size
    names: Sequence[str]
    outputs: Sequence[Array]
    takes_sizes: bool


def recognise(trial: Trial, wanted: NetworkLayout | None = None) -> Layout:
    """The layout of a network.

    Args:
        trial: Its outputs for blank images.
        wanted: The layout to take in place of the one that its outputs look like.

    Raises:
        ModelError: it has none of the known layouts, or not the one that is wanted.
    """
    name = wanted or _look(trial)
    outputs, shapes = trial.outputs, [output.shape for output in trial.outputs]
    columns = shapes[0][-1] if shapes and len(shapes[0]) == 3 else 0
    match name:
        case "yolox" if len(outputs) == 1 and columns > 5:
            reader = YoloxReader(columns - 5, is_in_pixels(outputs[0], trial.size_px))
            return Layout(name, "bgr_255", "top_left", columns - 5, reader)
        case "yolov5" if len(outputs) == 1 and columns > 5:
            return Layout(name, "rgb_1", "center", columns - 5, YoloV5Reader(columns - 5))
        case "yolov8" if len(outputs) == 1 and columns and shapes[0][1] > 4:
            return Layout(name, "rgb_1", "center", shapes[0][1] - 4, YoloV8Reader(shapes[0][1] - 4))
        case "end_to_end" if len(outputs) == 1 and columns == 6:
            return Layout(name, "rgb_1", "center", None, EndToEndReader())
        case "rtdetr" if len(outputs) == 1 and columns == 6 and _ends_with_class(outputs[0]):
            return Layout(name, "rgb_1", "stretched", None, RtDetrListReader())
        case "rtdetr" if len(outputs) == 1 and columns > 4:
            return Layout(name, "rgb_1", "stretched", columns - 4, RtDetrReader(columns - 4))
        case "detr" if found := _boxes_and_scores(trial):
            boxes_at, scores_at = found
            is_rf_detr = trial.names[boxes_at] == "dets"  # whose images are like those of its backbone
            colors: NetworkColors = "imagenet" if is_rf_detr else "rgb_1"
            classes = shapes[scores_at][-1]
            return Layout(name, colors, "stretched", classes, DetrReader(classes, boxes_at, scores_at))
        case "dfine" if trial.takes_sizes and (found3 := _labels_boxes_scores(trial)):
            return Layout(name, "rgb_1", "stretched", None, DfineReader(*found3))
    outputs_found = ", ".join(f"{one} {shape}" for one, shape in zip(trial.names, shapes, strict=True))
    of_kind = f"outputs of the layout {wanted}" if wanted else f"outputs of a known layout: {KNOWN}"
    raise ModelError(f"expected {of_kind}; found {outputs_found} for {trial.size_px[1]} x {trial.size_px[0]} px")


def _look(trial: Trial) -> NetworkLayout | None:
    """The layout that the outputs have by their shapes and numbers."""
    if trial.takes_sizes:
        return "dfine"
    if len(trial.outputs) == 2:
        return "detr"
    if len(trial.outputs) != 1 or trial.outputs[0].ndim != 3:
        return None
    _, rows, columns = trial.outputs[0].shape
    cells = [cell_count(trial.size_px, strides) for strides in PYRAMIDS_PX]
    if columns > 5 and rows == cells[0]:
        has_objectness = bool((trial.outputs[0][..., 4] != 1).any())  # YOLOv6 has ones in its place
        return "yolox" if has_objectness else "yolov5"
    if columns > 5 and rows in {ANCHORS_PER_CELL * count for count in cells}:
        return "yolov5"
    if rows > 4 and columns in cells:
        return "yolov8"
    # Boxes in shares of the image; all others are in pixels, or all 0 where an export with suppression finds nothing.
    is_in_shares = 0 < np.abs(trial.outputs[0][..., :4]).max(initial=0) < 2
    if columns == 6 and not is_in_shares:
        return "end_to_end"
    return "rtdetr" if columns > 4 and is_in_shares else None


def _ends_with_class(rows: Array) -> bool:
    """Whether the last column has numbers of classes, and no scores."""
    return bool((rows[..., -1] == np.floor(rows[..., -1])).all())


def _boxes_and_scores(trial: Trial) -> tuple[int, int] | None:
    """Which of two outputs are boxes (N, Q, 4) and scores (N, Q, C); by their names where both have four columns."""
    shapes = [output.shape for output in trial.outputs]
    if len(shapes) != 2 or any(len(shape) != 3 for shape in shapes) or shapes[0][:2] != shapes[1][:2]:
        return None
    boxes = [at for at, shape in enumerate(shapes) if shape[2] == 4]
    if len(boxes) == 2:
        boxes = [at for at in boxes if any(part in trial.names[at].lower() for part in ("box", "dets"))]
    if len(boxes) != 1 or np.abs(trial.outputs[boxes[0]]).max(initial=0) >= 2:
        return None
    return boxes[0], 1 - boxes[0]


def _labels_boxes_scores(trial: Trial) -> tuple[int, int, int] | None:
    """Which of three outputs are classes (N, K), boxes (N, K, 4) and scores (N, K), by their names."""
    found = [[at for at, name in enumerate(trial.names) if part in name.lower()] for part in ("label", "box", "score")]
    if len(trial.outputs) != 3 or any(len(one) != 1 for one in found) or len({one[0] for one in found}) < 3:
        return None
    return found[0][0], found[1][0], found[2][0]
