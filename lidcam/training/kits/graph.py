"""The networks of the kits as nodes of ONNX, from points in pillars to boxes."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.pillars.kits import KIT_INPUTS, KIT_OUTPUTS
from lidcam.training.kits.model import AnchorHead, Backbone, CenterHead, KitModel
from lidcam.training.onnx_graph import FLOAT, Graph

MAX_BOXES = 1000  # Of a network, or of each group of classes; lidcam keeps the best in each place
UNLIKELY = -30.0  # Log odds of a box for the classes of other groups
COUNTERS = ("num_batches_tracked", "global_step")  # What a training counts among its weights


class Weights:
    """Gives each layer its weights, and keeps track of those that no layer took."""

    def __init__(self, weights: Mapping[str, F64]) -> None:
        self.left = {name: array for name, array in weights.items() if name.rpartition(".")[2] not in COUNTERS}

    def take(self, name: str, *shape: int) -> F64:
        """Weights by name; raises ModelError if they are missing, or have another shape."""
        found = self.left.pop(name, None)
        if found is None or found.shape != shape:
            other = "none" if found is None else f"{found.shape}"
            raise ModelError(f"expected weights {name} {shape} in the checkpoint, found {other}")
        return found

    def take_folded(
        self, pair: tuple[str, str], shape: tuple[int, ...], eps: float, *, axis: int = 0, has_bias: bool = False
    ) -> tuple[F64, F64]:
        """Weights and bias of a layer with the normalisation folded in that is named after it in `pair`; see `take`.

        `shape` is that of the layer's weights, `axis` that of its outputs, `eps` that of the normalisation.
        """
        layer, norm = pair
        count = shape[axis]
        weight = self.take(f"{layer}.weight", *shape)
        bias = self.take(f"{layer}.bias", count) if has_bias else np.zeros(count)
        gain, shift, mean, variance = (
            self.take(f"{norm}.{part}", count) for part in ("weight", "bias", "running_mean", "running_var")
        )
        scale = gain / np.sqrt(variance + eps)
        along = [-1 if one == axis else 1 for one in range(len(shape))]
        return weight * scale.reshape(along), shift + (bias - mean) * scale


class Image(NamedTuple):
    """Name of a value (1, channels, rows, columns), and its channels."""

    name: str
    channels: int


def add_network(graph: Graph, model: KitModel, given: Mapping[str, F64]) -> None:
    """Add all nodes of a network, with `KIT_OUTPUTS`; raises ModelError if parts, or weights by name, do not fit."""
    weights, head = Weights(given), model.head
    image = _backbone(graph, model, weights, _encoded(graph, model, weights))
    if isinstance(head, CenterHead):
        _add_center_boxes(graph, model, head, weights, image)
    else:
        layers = {"conv_cls": len(model.specs.classes), model.names.boxes: head.code, "conv_dir_cls": head.directions}
        rows = [
            _rows(graph, weights, f"{model.names.head}.{layer}", image, len(head.anchors), numbers, 1)
            for layer, numbers in layers.items()
            if numbers
        ]
        _add_anchor_boxes(graph, model, head, *rows)
    if weights.left:
        some = ", ".join([*weights.left][:4])
        raise ModelError(f"expected no other weights in the checkpoint, found {len(weights.left)}: {some}")


def _add_anchor_boxes(
    graph: Graph, model: KitModel, head: AnchorHead, classes: str, boxes: str, directions: str = ""
) -> None:
    """Add the nodes that turn rows of anchors into boxes: log odds of classes and parts of a turn, and box numbers."""
    anchors, cells, count = head.anchors, _output_cells(model), np.array(len(head.anchors))
    likely = _likeliest(graph, classes, len(model.specs.classes), int(count * cells.prod()))
    low, high = np.array([one.low_m for one in anchors]), np.array([one.high_m for one in anchors])
    is_centred = np.array([[one.is_centred] for one in anchors])
    step = (high - low) / np.where(is_centred, cells, np.maximum(cells - 1, 1))
    size = np.array([one.size_m for one in anchors])
    z, yaw = np.array([one.z_m for one in anchors]), np.array([one.yaw_rad for one in anchors])
    anchor = graph.add_node("Mod", likely, count)
    first_xy, step_xy, anchor_z, sides, diagonal, height, anchor_yaw = (
        graph.add_node("Gather", one.reshape(len(anchors), -1), anchor)
        for one in (low + step / 2 * is_centred, step, z, size, np.hypot(size[:, 0], size[:, 1]), size[:, 2], yaw)
    )
    numbers = graph.add_node("Gather", boxes, likely)
    place = graph.add_node("Mul", _column_row(graph, graph.add_node("Div", likely, count), int(cells[0])), step_xy)
    moved = graph.add_node("Mul", _columns(graph, numbers, 0, 1), diagonal)
    xy = graph.add_node("Add", graph.add_node("Add", place, first_xy), moved)
    box_z = graph.add_node("Add", graph.add_node("Mul", _columns(graph, numbers, 2), height), anchor_z)
    sides = graph.add_node("Mul", graph.add_node("Exp", _columns(graph, numbers, 3, 4, 5)), sides)
    heading = graph.add_node("Add", _columns(graph, numbers, 6), anchor_yaw)
    if directions:
        part = np.array(2 * math.pi / head.directions)
        turns = graph.add_node("Gather", directions, likely)
        which = graph.add_node("Cast", graph.add_node("ArgMax", turns, axis=1), to=FLOAT)
        since = graph.add_node("Div", graph.add_node("Sub", heading, np.array(head.offset_rad)), part)
        whole = graph.add_node("Floor", graph.add_node("Add", since, np.array(head.limit)))
        heading = graph.add_node("Add", heading, graph.add_node("Mul", graph.add_node("Sub", which, whole), part))
    parts = xy, box_z, sides, graph.add_node("Sin", heading), graph.add_node("Cos", heading)
    graph.add_node("Concat", *parts, axis=1, name=KIT_OUTPUTS[0])
    graph.add_node("Gather", classes, likely, name=KIT_OUTPUTS[1])


def _add_center_boxes(graph: Graph, model: KitModel, head: CenterHead, weights: Weights, image: Image) -> None:
    names, grid, (conv, norm) = model.names, model.specs.grid, model.names.pair
    cells, kinds = _output_cells(model), len(model.specs.classes)
    if tuple(cells * head.stride) != grid.cells:
        raise ModelError(
            f"the output has {cells.tolist()} cells of {head.stride} pillars, for {list(grid.cells)} pillars"
        )
    shared = f"{names.head}.shared_conv"
    image = _convolved(graph, weights, image, (f"{shared}.{conv}", f"{shared}.{norm}"), head.shared, 3, 1, head)
    found, before = [], 0
    for task, classes in enumerate(head.tasks):
        rows = {}
        for branch, (numbers, layers) in {**head.branches, names.heat: (len(classes), head.heat_layers)}.items():
            is_needed = branch in (names.heat, *names.branches)
            made, part, own = image, f"{names.head}.{names.heads}.{task}.{branch}", graph if is_needed else Graph()
            for layer in range(layers - 1):
                pair = f"{part}.{layer}.{conv}", f"{part}.{layer}.{norm}"
                made = _convolved(own, weights, made, pair, head.width, head.kernel, 1, head)
            rows[branch] = _rows(own, weights, f"{part}.{layers - 1}", made, 1, numbers, head.kernel)
        likely = _likeliest(graph, rows[names.heat], len(classes), int(cells.prod()))
        offset, z, sides, turn, odds = (
            graph.add_node("Gather", rows[branch], likely) for branch in (*names.branches, names.heat)
        )
        place = graph.add_node("Add", _column_row(graph, likely, int(cells[0])), offset)
        metres = graph.add_node("Mul", place, np.array(grid.cell_m) * head.stride)
        xy = graph.add_node("Add", metres, np.array(grid.low_m[:2]))
        sine_cosine = _columns(graph, turn, *((0, 1) if head.sine_first else (1, 0)))
        boxes = graph.add_node("Concat", xy, z, graph.add_node("Exp", sides), sine_cosine, axis=1)
        count, after = min(int(cells.prod()), MAX_BOXES), kinds - before - len(classes)
        beside = [np.full((count, others), UNLIKELY) for others in (before, after)]
        found.append((boxes, graph.add_node("Concat", beside[0], odds, beside[1], axis=1)))
        before += len(classes)
    for output, parts in zip(KIT_OUTPUTS, zip(*found, strict=True), strict=True):
        graph.add_node("Concat", *parts, axis=0, name=output)


def _encoded(graph: Graph, model: KitModel, weights: Weights) -> Image:
    """The pillars as an image that holds the maximum over the points of each."""
    (columns, rows), eps = model.specs.grid.cells, model.encoder.eps
    points, before, last = KIT_INPUTS[0], len(model.specs.features), len(model.encoder.channels) - 1
    for row, channels in enumerate(model.encoder.channels):
        width, name = channels if row == last else channels // 2, f"{model.names.encoder}.{row}"
        weight, bias = weights.take_folded((f"{name}.linear", f"{name}.norm"), (width, before), eps)
        points = graph.add_node("Relu", graph.add_node("Add", graph.add_node("MatMul", points, weight.T), bias))
        empty = graph.add_node("ConstantOfShape", np.array([columns * rows, width]))
        canvas = graph.add_node("ScatterND", empty, KIT_INPUTS[1], points, reduction="max")
        if row < last:
            points = graph.add_node("Concat", points, graph.add_node("GatherND", canvas, KIT_INPUTS[1]), axis=1)
        before = 2 * width
    flat = graph.add_node("Transpose", canvas, perm=[1, 0])
    return Image(graph.add_node("Reshape", flat, np.array([1, width, rows, columns])), width)


def _backbone(graph: Graph, model: KitModel, weights: Weights, image: Image) -> Image:
    """All blocks, each scaled to the size of the output."""
    parts, first, raised = model.backbone, model.names.first, []
    for block, (channels, layers, stride) in enumerate(zip(parts.channels, parts.layers, parts.strides, strict=True)):
        name = f"{model.names.blocks}.{block}"
        for layer in range(layers + 1):
            pair = f"{name}.{first + 3 * layer}", f"{name}.{first + 3 * layer + 1}"
            image = _convolved(graph, weights, image, pair, channels, 3, 1 if layer else stride, parts)
        name = f"{model.names.ups}.{block}"
        up_channels, up_stride, pair = parts.up_channels[block], parts.up_strides[block], (f"{name}.0", f"{name}.1")
        if up_stride < 1 or (up_stride == 1 and parts.convolves):
            side = round(1 / up_stride)
            folded = weights.take_folded(pair, (up_channels, image.channels, side, side), parts.up_eps)
            up = graph.add_node("Conv", image.name, *folded, strides=[side, side])
        else:
            side = int(up_stride)
            folded = weights.take_folded(pair, (image.channels, up_channels, side, side), parts.up_eps, axis=1)
            sides = [side, side]
            up = graph.add_node("ConvTranspose", image.name, *folded, strides=sides, kernel_shape=sides)
        raised.append(graph.add_node("Relu", up))
    return Image(graph.add_node("Concat", *raised, axis=1), sum(parts.up_channels))


def _output_cells(model: KitModel) -> I64:
    """(2,) number of cells of the output along x and y."""
    size, sizes = np.array(model.specs.grid.cells), []
    for stride, up in zip(model.backbone.strides, model.backbone.up_strides, strict=True):
        size = (size - 1) // stride + 1
        sizes.append(tuple((size // round(1 / up) if up < 1 else size * int(up)).tolist()))
    if len({*sizes}) > 1:
        raise ModelError(f"the blocks of the network become images of different sizes: {sizes}")
    return np.array(sizes[0])


def _convolved(
    graph: Graph,
    weights: Weights,
    image: Image,
    pair: tuple[str, str],
    channels: int,
    kernel: int,
    stride: int,
    part: Backbone | CenterHead,
) -> Image:
    """A convolution, its normalisation and a ReLU."""
    shape, has_bias = (channels, image.channels, kernel, kernel), isinstance(part, CenterHead) and part.has_bias
    folded = weights.take_folded(pair, shape, part.eps, has_bias=has_bias)
    made = graph.add_node("Conv", image.name, *folded, strides=[stride, stride], pads=[kernel // 2] * 4)
    return Image(graph.add_node("Relu", made), channels)


def _rows(graph: Graph, weights: Weights, name: str, image: Image, anchors: int, numbers: int, kernel: int) -> str:
    """A last convolution, as rows of numbers for all cells along y; the anchors of a cell follow each other."""
    weight = weights.take(f"{name}.weight", anchors * numbers, image.channels, kernel, kernel)
    bias, pads = weights.take(f"{name}.bias", anchors * numbers), [kernel // 2] * 4
    last = graph.add_node("Transpose", graph.add_node("Conv", image.name, weight, bias, pads=pads), perm=[0, 2, 3, 1])
    return graph.add_node("Reshape", last, np.array([-1, numbers]))


def _columns(graph: Graph, rows: str, *wanted: int) -> str:
    return graph.add_node("Gather", rows, np.array(wanted), axis=1)


def _column_row(graph: Graph, cell: str, columns: int) -> str:
    """(K, 2) float32 column and row of cells (K,)."""
    flat, count = graph.add_node("Reshape", cell, np.array([-1, 1])), np.array(columns)
    both = graph.add_node("Concat", graph.add_node("Mod", flat, count), graph.add_node("Div", flat, count), axis=1)
    return graph.add_node("Cast", both, to=FLOAT)


def _likeliest(graph: Graph, log_odds: str, kinds: int, count: int) -> str:
    """(K,) numbers of those of `count` rows that have the likeliest classes."""
    best = log_odds if kinds == 1 else graph.add_node("TopK", log_odds, np.array([1]), axis=1)
    flat = graph.add_node("Reshape", best, np.array([-1]))
    return f"{graph.add_node('TopK', flat, np.array([min(count, MAX_BOXES)]))}.second"
