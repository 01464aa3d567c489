"""Networks of every layout for tests, with known outputs, in the ONNX files of `onnx_files`.

Each output is a constant array, plus what the image's brightness makes of it where `weights` say so; or, of a
convolutional YOLOX, what a convolution makes of each cell.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from onnx_files import FLOAT, FLOAT16, INT64, _node, _tensor, _value, write_model

from lidcam.pipeline.core.arrays import Array

KINDS = {np.dtype(np.float32): FLOAT, np.dtype(np.int64): INT64, np.dtype(np.float16): FLOAT16}
Shape = Sequence[int | str]


def write_network(
    path: Path,
    outputs: Mapping[str, Array],
    *,
    size_px: Shape,
    batch: int | str = 1,
    dtype: int = FLOAT,
    weights: Mapping[str, Array] | None = None,
    scaled: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write a network that gives the same arrays for each image of a batch."""
    nodes = [_node("ReduceMean", ["images"], "mean", axes=[1, 2, 3], keepdims=0)]
    nodes.append(_node("Cast", ["mean"], "brightness", to=FLOAT))
    constants = []
    for name, array in outputs.items():
        weight = (weights or {}).get(name, np.zeros(array.shape))
        constants.append(_tensor(f"{name}.weight", weight[None].astype(np.float32), FLOAT))
        constants.append(_tensor(f"{name}.bias", array[None].astype(np.float32), FLOAT))
        nodes.append(_node("Unsqueeze", ["brightness"], f"{name}.column", axes=list(range(1, array.ndim + 1))))
        nodes.append(_node("Mul", [f"{name}.column", f"{name}.weight"], f"{name}.gain"))
        nodes.append(_node("Add", [f"{name}.gain", f"{name}.bias"], f"{name}.sum"))
        last = f"{name}.sum"
        if name in scaled:
            nodes.append(_node("Mul", [last, "scale"], f"{name}.scaled"))
            last = f"{name}.scaled"
        nodes.append(_node("Cast", [last], name, to=KINDS[array.dtype]))
    inputs = [_value("images", (batch, 3, *size_px), dtype)]
    if scaled:
        nodes[:0] = [
            _node("Cast", ["orig_target_sizes"], "sizes", to=FLOAT),
            _node("Concat", ["sizes", "sizes"], "sizes4", axis=1),
            _node("Unsqueeze", ["sizes4"], "scale", axes=[1]),
        ]
        inputs.append(_value("orig_target_sizes", (batch, 2), INT64))
    stated = [_value(name, (batch, *array.shape), KINDS[array.dtype]) for name, array in outputs.items()]
    return write_model(path, nodes, constants, inputs, stated, metadata=metadata)


def write_convolutional(
    path: Path,
    kernels: Sequence[Array],
    biases: Sequence[Array],
    *,
    size_px: Shape,
    strides: Sequence[int] = (8, 16, 32),
) -> Path:
    """Write a YOLOX of one convolution for each stride, whose kernels (5 + C, 3, S, S) cover the cells.

    The file states one size, that of its input, as exports do, also between its nodes; it computes any other.
    """
    nodes, constants, levels, inner = [], [], [], []
    for stride, kernel, bias in zip(strides, kernels, biases, strict=True):
        constants += [
            _tensor(f"kernel{stride}", kernel.astype(np.float32), FLOAT),
            _tensor(f"bias{stride}", bias.astype(np.float32), FLOAT),
        ]
        sides = {"kernel_shape": [stride, stride], "strides": [stride, stride]}
        nodes.append(_node("Conv", ["images", f"kernel{stride}", f"bias{stride}"], f"level{stride}", **sides))
        nodes.append(_node("Reshape", [f"level{stride}", "rows"], f"rows{stride}"))
        levels.append(f"rows{stride}")
        inner.append(_value(f"level{stride}", (1, len(bias), *(int(n) // stride for n in size_px)), FLOAT))
    columns = len(biases[0])
    constants.append(_tensor("rows", np.array([1, columns, -1]), INT64))
    nodes.append(_node("Concat", levels, "joined", axis=2))
    nodes.append(_node("Transpose", ["joined"], "output", perm=[0, 2, 1]))
    cells = sum(int(size_px[0]) // stride * (int(size_px[1]) // stride) for stride in strides)
    inputs, outputs = [_value("images", (1, 3, *size_px), FLOAT)], [_value("output", (1, cells, columns), FLOAT)]
    return write_model(path, nodes, constants, inputs, outputs, inner=inner)
