"""Layouts of the outputs of networks in ONNX files: recognised by a trial run, then read as boxes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from lidcam.pipeline.core.arrays import F32, I64, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import NetworkColors, NetworkLayout
from lidcam.pipeline.detectors.onnx.preprocessing import Placement
from lidcam.pipeline.detectors.protocols import Candidates2D

STRIDES_PX = (8, 16, 32)
PYRAMIDS_PX = (STRIDES_PX, (8, 16, 32, 64), (4, 8, 16, 32), (16, 32))
"""Strides of the grids of YOLO networks; the usual ones first."""

ANCHORS_PER_CELL = 3
"""Anchors of YOLOv5 and YOLOv7."""

KNOWN = (
    "YOLOX (N, A, 5 + C), YOLOv5 (N, 3 A, 5 + C), YOLOv8 (N, 4 + C, A), end-to-end (N, K, 6), RT-DETR (N, Q, 4 + C), "
    "boxes (N, Q, 4) and scores (N, Q, C), or labels, boxes and scores"
)

Size = tuple[int, int]
"""Height and width of a network's input, pixels."""

Shape = tuple[int | None, ...]


@dataclass(frozen=True, slots=True)
class Trial:
    """Outputs of a network for blank images."""

    size_px: Size  # Height and width of its input
    names: Sequence[str]  # Names of its outputs
    outputs: Sequence[Array]  # Its outputs
    takes_sizes: bool  # Whether it has a second input for the sizes of the images


@dataclass(frozen=True, slots=True)
class Layout:
    """Meaning of the inputs and outputs of a network."""

    name: NetworkLayout  # Value of `detect2d.layout`
    colors: NetworkColors  # Colours of its input
    placement: Placement  # Place of an image in its input
    class_count: int | None  # Number of its classes; None where its outputs do not say
    # Makes proposals of the outputs for one image, the size of the input, and the least score wanted
    read_image: Callable[..., Candidates2D]
    shapes: tuple[Shape, ...]  # Shapes of these outputs for one image; None: any number
    outputs_at: tuple[int, ...] = (0,)  # Their places among the outputs

    def read(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """Proposals for each image of a batch, in pixels of the network's input.

        Boxes beyond the range of numbers are not finite; a caller leaves them out, and has numpy keep quiet.

        Args:
            outputs: All outputs of the network, in its order; numbers.
            count: Images of the batch.
            size_px: Height and width of the network's input.
            min_score: Proposals with a lower score may be left out; scores are at most 1.

        Raises:
            ModelError: the outputs are not of the layout.
        """
        parts = [outputs[at] for at in self.outputs_at]
        for part, shape in zip(parts, self.shapes, strict=True):
            expected = (count, *shape)
            if part.ndim != len(expected) or any(n not in (None, m) for n, m in zip(expected, part.shape, strict=True)):
                text = ", ".join("any" if wanted is None else str(wanted) for wanted in expected)
                raise ModelError(f"expected an output of the layout {self.name}, ({text}), found {part.shape}")
        if len({part.shape[1] for part in parts}) > 1:
            raise ModelError(f"expected outputs of the same length, found {[part.shape for part in parts]}")
        return [self.read_image(*one, size_px=size_px, min_score=min_score) for one in zip(*parts, strict=True)]


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
            # Raw centres are a few cells at most; centres in pixels span the whole image, whatever its content.
            is_in_pixels = float(outputs[0][..., :2].max()) > min(trial.size_px) / 2
            read = partial(_read_yolox, is_in_pixels=is_in_pixels)
            return Layout(name, "bgr_255", "top_left", columns - 5, read, ((None, columns),))
        case "yolov5" if len(outputs) == 1 and columns > 5:
            return Layout(name, "rgb_1", "center", columns - 5, _read_yolov5, ((None, columns),))
        case "yolov8" if len(outputs) == 1 and columns and (rows := shapes[0][1]) > 4:
            return Layout(name, "rgb_1", "center", rows - 4, _read_yolov8, ((rows, None),))
        case "end_to_end" if len(outputs) == 1 and columns == 6:
            return Layout(name, "rgb_1", "center", None, _read_end_to_end, ((None, 6),))
        case "rtdetr" if len(outputs) == 1 and columns == 6 and _ends_with_class(outputs[0]):
            return Layout(name, "rgb_1", "stretched", None, _read_rtdetr_listed, ((None, 6),))
        case "rtdetr" if len(outputs) == 1 and columns > 4:
            return Layout(name, "rgb_1", "stretched", columns - 4, _read_rtdetr, ((None, columns),))
        case "detr" if both := _boxes_and_scores(trial):
            is_rf_detr = trial.names[both[0]] == "dets"  # whose images are like those of its backbone
            colors: NetworkColors = "imagenet" if is_rf_detr else "rgb_1"
            classes = shapes[both[1]][-1]
            return Layout(name, colors, "stretched", classes, _read_detr, ((None, 4), (None, classes)), both)
        case "dfine" if trial.takes_sizes and (three := _labels_boxes_scores(trial)):
            return Layout(name, "rgb_1", "stretched", None, _read_dfine, ((None,), (None, 4), (None,)), three)
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
    cells = [_cell_count(trial.size_px, strides) for strides in PYRAMIDS_PX]
    if columns > 5 and rows in cells and (trial.outputs[0][..., 4] == 1).all():  # YOLOv6: ones in place of objectness
        return "yolov5"
    if columns > 5 and rows == cells[0]:
        return "yolox"
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
    """Places of the outputs boxes (N, Q, 4) and scores (N, Q, C); by their names where both have four columns."""
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
    """Places of the outputs classes (N, K), boxes (N, K, 4) and scores (N, K), by their names."""
    found = [[at for at, name in enumerate(trial.names) if part in name.lower()] for part in ("label", "box", "score")]
    if len(trial.outputs) != 3 or any(len(one) != 1 for one in found) or len({one[0] for one in found}) < 3:
        return None
    return found[0][0], found[1][0], found[2][0]


def _read_yolox(rows: F32, *, size_px: Size, min_score: float, is_in_pixels: bool) -> Candidates2D:
    """YOLOX (Ge et al., arXiv:2107.08430): (A, 5 + C), one row per cell of the grids of stride 8, 16 and 32.

    Centre and size, objectness, C scores. Centre and size are either raw (offset from the cell and logarithm, in
    cells) or, after an export with `--decode_in_inference`, in pixels.
    """
    if len(rows) != _cell_count(size_px):
        raise ModelError(f"expected a YOLOX output of {_cell_count(size_px)} rows, found {len(rows)}")
    taken = np.flatnonzero(rows[:, 4] >= min_score)
    rows = rows[taken]
    centers, sizes = rows[:, :2], rows[:, 2:4]
    if not is_in_pixels:
        grid, stride = (cells[taken] for cells in _cells_of(size_px))
        centers, sizes = (centers + grid) * stride, np.exp(sizes) * stride
    scores, labels = _best_class(rows[:, 5:])
    return Candidates2D(_corners_of(centers, sizes), rows[:, 4] * scores, labels)


def _read_yolov5(rows: F32, *, min_score: float, **_: object) -> Candidates2D:
    """YOLOv5, YOLOv6, YOLOv7: (A, 5 + C), rows of centre and size in pixels, objectness, C scores."""
    rows = rows[rows[:, 4] >= min_score]
    scores, labels = _best_class(rows[:, 5:])
    return Candidates2D(_corners_of(rows[:, :2], rows[:, 2:4]), rows[:, 4] * scores, labels)


def _read_yolov8(columns: F32, *, min_score: float, **_: object) -> Candidates2D:
    """YOLOv8, YOLOv9, YOLO11, YOLO12: (4 + C, A), columns of centre and size in pixels, C scores."""
    rows = columns[:, columns[4:].max(0) >= min_score].T
    return Candidates2D(_corners_of(rows[:, :2], rows[:, 2:4]), *_best_class(rows[:, 4:]))


def _read_end_to_end(rows: F32, **_: object) -> Candidates2D:
    """YOLOv10, YOLO26, exports with `nms=True`: (K, 6), rows of left, top, right, bottom in pixels, score, class."""
    return _listed(rows[:, :4], rows[:, 4], rows[:, 5])


def _read_rtdetr(rows: F32, *, size_px: Size, **_: object) -> Candidates2D:
    """RT-DETR as Ultralytics exported it up to 8.3: (Q, 4 + C), rows of centre and size in shares, C scores."""
    return Candidates2D(_in_pixels(rows[:, :4], size_px), *_best_class(rows[:, 4:]))


def _read_rtdetr_listed(rows: F32, *, size_px: Size, **_: object) -> Candidates2D:
    """RT-DETR as Ultralytics exports it since 8.4: (K, 6), rows of centre and size in shares, score, class."""
    return _listed(_in_pixels(rows[:, :4], size_px), rows[:, 4], rows[:, 5])


def _read_detr(boxes: F32, logits: F32, *, size_px: Size, **_: object) -> Candidates2D:
    """RT-DETR, D-FINE, RF-DETR: centre and size in shares (Q, 4), and log odds of the classes (Q, C)."""
    scores = np.asarray(1 / (1 + np.exp(-logits)), np.float32)
    return Candidates2D(_in_pixels(boxes, size_px), *_best_class(scores))


def _read_dfine(labels: Array, boxes: F32, scores: F32, **_: object) -> Candidates2D:
    """RT-DETRv2, D-FINE and DEIM with their post-processing: classes (K,), boxes (K, 4), scores (K,).

    Boxes are left, top, right, bottom in pixels of the size that is given as a second input.
    """
    return _listed(boxes, scores, labels)


def _cell_count(size_px: Size, strides_px: Sequence[int] = STRIDES_PX) -> int:
    """Cells of the grids of all strides."""
    return sum((size_px[0] // stride) * (size_px[1] // stride) for stride in strides_px)


@lru_cache(maxsize=32)
def _cells_of(size_px: Size) -> tuple[F32, F32]:
    """Column and row of the cell (A, 2) and stride in pixels (A, 1) of each row of the output."""
    grids, strides = [], []
    for stride in STRIDES_PX:
        row, column = np.indices((size_px[0] // stride, size_px[1] // stride))
        grids.append(np.stack([column.ravel(), row.ravel()], 1))
        strides.append(np.full((row.size, 1), stride))
    return np.concatenate(grids).astype(np.float32), np.concatenate(strides).astype(np.float32)


def _best_class(scores: F32) -> tuple[F32, I64]:
    """The largest score of each row (N, C) and where it stands; of equal ones the first."""
    labels = scores.argmax(1)
    return np.take_along_axis(scores, labels[:, None], 1)[:, 0], labels


def _corners_of(centers: F32, sizes: F32) -> F32:
    """Left, top, right, bottom (N, 4) of boxes by centre and size (N, 2)."""
    return np.concatenate([centers - sizes / 2, centers + sizes / 2], 1)


def _in_pixels(boxes: F32, size_px: Size) -> F32:
    """Corners in pixels of boxes (Q, 4) by centre and size in shares of the image."""
    image = np.array([size_px[1], size_px[0]], np.float32)
    return _corners_of(boxes[:, :2] * image, boxes[:, 2:] * image)


def _listed(xyxy: F32, scores: F32, labels: Array) -> Candidates2D:
    """Boxes with a class each; rows without a score are filling."""
    taken = scores > 0
    classes = labels[taken].astype(np.float64)
    is_class = (classes >= 0) & (classes < 2**31) & (classes == np.floor(classes))
    if not is_class.all():
        raise ModelError(f"expected numbers of classes, found {classes[~is_class][0]:g}")
    return Candidates2D(xyxy[taken], scores[taken], classes.astype(np.int64))
