"""A trained network as an ONNX file.

Written here, as PyTorch's exporters need packages of their own. Normalisation is folded into the layer before it.
"""

from functools import cache
from typing import Any

import numpy as np
import torch
from torch import nn

from lidcam.training.pillars.network import WIDTH, PillarNetwork
from pipeline.core.arrays import Array
from pipeline.detectors.onnx.messages import MANY, ONE, model_class
from pipeline.detectors.pillars.decoding import BOX_NUMBERS
from pipeline.detectors.pillars.grid import FEATURES, STRIDE
from pipeline.detectors.pillars.network import INPUTS, KEY, PillarSpecs

__all__ = ["onnx_bytes"]

FIELDS = {
    "Model": [
        ("ir_version", 1, ONE, "int64"),
        ("graph", 7, ONE, "Graph"),
        ("opset", 8, MANY, "Opset"),
        ("metadata", 14, MANY, "Entry"),
    ],
    "Opset": [("version", 2, ONE, "int64")],
    "Entry": [("key", 1, ONE, "bytes"), ("value", 2, ONE, "bytes")],
    "Graph": [
        ("node", 1, MANY, "Node"),
        ("name", 2, ONE, "bytes"),
        ("tensor", 5, MANY, "Tensor"),
        ("input", 11, MANY, "Value"),
        ("output", 12, MANY, "Value"),
    ],
    "Node": [
        ("input", 1, MANY, "bytes"),
        ("output", 2, MANY, "bytes"),
        ("op", 4, ONE, "bytes"),
        ("attribute", 5, MANY, "Attribute"),
    ],
    "Attribute": [
        ("name", 1, ONE, "bytes"),
        ("text", 4, ONE, "bytes"),
        ("ints", 8, MANY, "int64"),
        ("type", 20, ONE, "int64"),
    ],
    "Tensor": [
        ("dims", 1, MANY, "int64"),
        ("type", 2, ONE, "int64"),
        ("name", 8, ONE, "bytes"),
        ("data", 9, ONE, "bytes"),
    ],
    "Value": [("name", 1, ONE, "bytes"), ("type", 2, ONE, "Type")],
    "Type": [("tensor", 1, ONE, "TensorType")],
    "TensorType": [("kind", 1, ONE, "int64"), ("shape", 2, ONE, "Shape")],
    "Shape": [("dims", 1, MANY, "Dim")],
    "Dim": [("size", 1, ONE, "int64"), ("name", 2, ONE, "bytes")],
}
"""The fields of onnx.proto3 (github.com/onnx/onnx) that are written."""

IR_VERSION, OPSET = 8, 18
FLOAT, INT64 = 1, 7
TEXT, INTS = 3, 7


class _Graph:
    """Nodes, each behind the one before it, and their constants."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self.tensors: list[dict[str, Any]] = []

    def add(self, op: str, *inputs: str | Array, **attributes: list[int] | bytes) -> str:
        """The name of the output of a new node; inputs are names, or constants."""
        name = f"{op}{len(self.nodes)}"
        names = [
            (one if isinstance(one, str) else self._constant(f"{name}.{row}", one)).encode()
            for row, one in enumerate(inputs)
        ]
        said = [
            {"name": key.encode()}
            | ({"text": value, "type": TEXT} if isinstance(value, bytes) else {"ints": value, "type": INTS})
            for key, value in attributes.items()
        ]
        self.nodes.append({"op": op.encode(), "input": names, "output": [name.encode()], "attribute": said})
        return name

    def _constant(self, name: str, array: Array) -> str:
        is_whole = array.dtype.kind == "i"
        data = np.ascontiguousarray(array, "<i8" if is_whole else "<f4")
        kind = INT64 if is_whole else FLOAT
        self.tensors.append({"name": name.encode(), "dims": data.shape, "type": kind, "data": data.tobytes()})
        return name


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs) -> bytes:
    """The content of a file; the same network makes the same bytes."""
    network = network.eval().cpu()
    graph, cells = _Graph(), specs.grid.cells
    weight, bias = _folded(network.encoder[0], network.encoder[1], 0)
    encoded = graph.add("Relu", graph.add("Add", graph.add("MatMul", "features", weight.T), bias))
    empty = graph.add("ConstantOfShape", np.array([cells * cells, WIDTH]))
    canvas = graph.add("ScatterND", empty, "pillar", encoded, reduction=b"max")
    image = graph.add("Reshape", graph.add("Transpose", canvas, perm=[1, 0]), np.array([1, WIDTH, cells, cells]))
    total = ""
    for block, up in zip(network.blocks, network.ups, strict=True):
        image = _convolutions(graph, image, block)
        convolution, norm = _parts(up)
        stride = list(convolution.stride)
        raised = graph.add("ConvTranspose", image, *_folded(convolution, norm, 1), strides=stride, kernel_shape=stride)
        total = graph.add("Add", total, raised) if total else raised
    last = [_numbers(network.last.weight), _numbers(network.last.bias)]
    graph.add("Conv", _convolutions(graph, graph.add("Relu", total), network.head), *last)
    side = cells // STRIDE
    inputs = [_value(INPUTS[0], FLOAT, "points", len(FEATURES)), _value(INPUTS[1], INT64, "points", 1)]
    outputs = [_value("numbers", FLOAT, 1, len(specs.classes) + BOX_NUMBERS, side, side)]
    graph.nodes[-1]["output"] = [b"numbers"]
    model = _model_class()(
        ir_version=IR_VERSION,
        opset=[{"version": OPSET}],
        graph={"name": b"pillars", "node": graph.nodes, "tensor": graph.tensors, "input": inputs, "output": outputs},
        metadata=[{"key": KEY.encode(), "value": specs.model_dump_json().encode()}],
    )
    return bytes(model.SerializeToString(deterministic=True))


def _convolutions(graph: _Graph, image: str, layers: nn.Module) -> str:
    parts = _parts(layers)
    for convolution, norm in zip(parts[::3], parts[1::3], strict=True):
        strides = list(convolution.stride)
        made = graph.add("Conv", image, *_folded(convolution, norm, 0), strides=strides, pads=[1, 1, 1, 1])
        image = graph.add("Relu", made)
    return image


def _parts(layers: nn.Module) -> list[Any]:
    return list(layers.children())


def _folded(layer: Any, norm: Any, axis: int) -> tuple[Array, Array]:
    """Weights and bias of a layer without bias and the normalisation behind it; its outputs are along an axis."""
    scale = _numbers(norm.weight) / np.sqrt(_numbers(norm.running_var) + norm.eps)
    weight = _numbers(layer.weight)
    shape = [1] * weight.ndim
    shape[axis] = -1
    return weight * scale.reshape(shape), _numbers(norm.bias) - _numbers(norm.running_mean) * scale


def _numbers(tensor: Any) -> Array:
    return np.asarray(tensor.detach().to(torch.float64).numpy())


def _value(name: str, kind: int, *dims: int | str) -> dict[str, Any]:
    shape = [{"name": one.encode()} if isinstance(one, str) else {"size": one} for one in dims]
    return {"name": name.encode(), "type": {"tensor": {"kind": kind, "shape": {"dims": shape}}}}


@cache
def _model_class() -> Any:
    return model_class("lidcam.pillars", FIELDS)
