"""The same network in fewer steps, where onnxruntime does not see that itself.

What does not look just so stays as it is, and so do graphs with loops or branches.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import F32
from pipeline.detectors.onnx.model_file import FLOAT, INTS, Wiring, attributes_of

__all__ = ["drop_last_transposes", "fold_focus"]

COLORS = 3
CORNERS = [(0, 0), (0, 1), (1, 0), (1, 1)]
PLAIN = {"strides": [1, 1], "dilations": [1, 1], "group": 1, "auto_pad": b"NOTSET"}
LEAST_END = (1 << 31) - 1
"""Slices that end where their input ends say so by this or by more."""


class _Focus(NamedTuple):
    """A convolution of what Focus makes of an image.

    Attributes:
        image: Name of the image.
        corners: First row and first column of each slice, in their order.
        kernel: (O, 12, K, L).
        pads: Above, left, below, right, of the slices.
    """

    image: bytes
    corners: Sequence[tuple[int, int]]
    kernel: F32
    pads: Sequence[int]


def fold_focus(graph: Any) -> bool:
    """Let the first convolution of YOLOX, and of YOLOv5 before its release 6.0, look at the image itself.

    These networks begin with Focus: four slices of the image, every second row and column each, become its channels,
    which a convolution of K x L looks at. That is a convolution of 2 K x 2 L of the image in steps of 2, with the same
    products in another order; YOLOv5 has it so since 6.0 (github.com/ultralytics/yolov5/discussions/3181).

    Args:
        graph: Of an ONNX file (`read_model`); it is changed.

    Returns:
        Whether there was a Focus.
    """
    wiring = Wiring(graph)
    for node in graph.nodes if wiring.is_flat else ():
        if (found := _focus(node, wiring)) is not None:
            _fold(graph, node, found, wiring)
            return True
    return False


def _fold(graph: Any, node: Any, found: _Focus, wiring: Wiring) -> None:
    outputs, _, height, width = found.kernel.shape
    kernel = np.zeros((outputs, COLORS, 2 * height, 2 * width), "<f4")
    for block, (row, column) in enumerate(found.corners):
        kernel[:, :, row::2, column::2] = found.kernel[:, block * COLORS : (block + 1) * COLORS]
    sliced, name = node.inputs[0], node.inputs[0] + b"/kernel"
    graph.constants.add(name=name, dims=kernel.shape, kind=FLOAT, raw=kernel.tobytes())
    node.inputs[0], node.inputs[1] = found.image, name
    wiring.uses[found.image] += 1
    del node.attributes[:]
    for key, ints in (("kernel_shape", kernel.shape[2:]), ("strides", (2, 2)), ("pads", [2 * n for n in found.pads])):
        node.attributes.add(name=key.encode(), ints=ints, kind=INTS)
    for row in sorted(wiring.only_for(sliced), reverse=True):
        del graph.nodes[row]


def _focus(node: Any, wiring: Wiring) -> _Focus | None:
    """What a node makes of Focus, if it does nothing else."""
    if node.op != b"Conv" or node.domain or len(node.inputs) < 2:
        return None
    joined, kernel = wiring.made_by(node.inputs[0], b"Concat"), wiring.floats(node.inputs[1])
    if joined is None or kernel is None or kernel.ndim != 4 or kernel.shape[1] != len(CORNERS) * COLORS:
        return None
    if wiring.uses[node.inputs[0]] > 1 or attributes_of(joined).get("axis") != 1:
        return None
    told = attributes_of(node)
    pads: list[int] = told.pop("pads", [0, 0, 0, 0])
    plain = PLAIN | {"kernel_shape": list(kernel.shape[2:])}
    if plain | told != plain:
        return None
    sliced = [_sliced(name, wiring) for name in joined.inputs]
    corners = [one[1] for one in sliced if one is not None]
    images = {one[0] for one in sliced if one is not None}
    if len(sliced) != len(CORNERS) or sorted(corners) != CORNERS or len(images) != 1:
        return None
    return _Focus(images.pop(), corners, kernel, pads)


def _sliced(name: bytes, wiring: Wiring) -> tuple[bytes, tuple[int, int]] | None:
    """Of what a value is every second row and column, and from which on; None if it is something else."""
    starts: dict[int, int] = {}
    while len(starts) < 2:
        node = wiring.made_by(name, b"Slice")
        if node is None or len(node.inputs) != 5:
            return None
        told = [wiring.int64s(one) for one in node.inputs[1:]]
        if len({len(one) for one in told}) != 1:
            return None
        for start, end, axis, step in zip(*told, strict=True):
            if start not in (0, 1) or end < LEAST_END or axis not in (2, 3) or axis in starts or step != 2:
                return None
            starts[axis] = start
        name = node.inputs[0]
    return name, (starts[2], starts[3])


def drop_last_transposes(graph: Any) -> dict[int, list[int]]:
    """Leave it to the reader to transpose outputs: where that is the last step, a view of the output does the same.

    Args:
        graph: Of an ONNX file (`read_model`); it is changed.

    Returns:
        The order of dimensions by the number of the output, of those that are no longer transposed.
    """
    wiring, orders = Wiring(graph), dict[int, list[int]]()
    for number, output in enumerate(graph.outputs if wiring.is_flat else ()):
        node = wiring.made_by(output.name, b"Transpose")
        order = attributes_of(node).get("perm") if node is not None else None
        if not order or wiring.uses[output.name] > 1 or wiring.uses[node.inputs[0]] > 1:
            continue
        if (maker := wiring.maker.get(node.inputs[0])) is None:
            continue
        names = graph.nodes[maker].outputs
        names[list(names).index(node.inputs[0])] = output.name
        node.op, node.outputs[0] = b"", b""
        output.type.tensor.ClearField("shape")
        orders[number] = order
    for row in reversed([row for row, node in enumerate(graph.nodes) if not node.op]):
        del graph.nodes[row]
    return orders
