"""A trained network as an ONNX file.

Written here, as PyTorch's exporters need packages of their own. Normalisation is folded into the layer before it.
"""

from collections.abc import Mapping, Sequence
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

__all__ = ["FLOAT", "OnnxGraph", "convolutions", "numbers", "onnx_bytes", "value"]

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
        ("int", 3, ONE, "int64"),
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
FLOAT, INT64, HALF = 1, 7, 10
ATTRIBUTES = {int: ("int", 2), bytes: ("text", 3), list: ("ints", 7)}
"""Field and number of the type of an attribute."""


Values = Sequence[Mapping[str, Any]]
"""Inputs or outputs; see `value`."""


class OnnxGraph:
    """Nodes, each behind the one before it, and their constants.

    Args:
        half: Whether the file has numbers in half precision, which make it half as large; it computes in single.
    """

    def __init__(self, *, half: bool = False) -> None:
        self._half = half
        self.nodes: list[dict[str, Any]] = []
        self.tensors: list[dict[str, Any]] = []

    def add(self, op: str, *inputs: str | Array, **attributes: int | list[int] | bytes) -> str:
        """The name of the output of a new node; inputs are names, or constants."""
        name = f"{op}{len(self.nodes)}"
        names = [
            (one if isinstance(one, str) else self._constant(f"{name}.{row}", one)).encode()
            for row, one in enumerate(inputs)
        ]
        said = [
            {"name": key.encode(), field: value, "type": kind}
            for key, value in attributes.items()
            for field, kind in [ATTRIBUTES[type(value)]]
        ]
        self.nodes.append({"op": op.encode(), "input": names, "output": [name.encode()], "attribute": said})
        return name

    def _constant(self, name: str, array: Array) -> str:
        is_whole = array.dtype.kind == "i"
        is_half = self._half and not is_whole
        data = np.ascontiguousarray(array, "<i8" if is_whole else "<f2" if is_half else "<f4")
        kind = INT64 if is_whole else HALF if is_half else FLOAT
        self.tensors.append({"name": name.encode(), "dims": data.shape, "type": kind, "data": data.tobytes()})
        return self.add("Cast", name, to=FLOAT) if is_half else name

    def to_bytes(self, name: str, inputs: Values, outputs: Values, metadata: Mapping[str, str]) -> bytes:
        """The content of a file whose output is that of the last node."""
        self.nodes[-1]["output"] = [outputs[-1]["name"]]
        graph = {"name": name.encode(), "node": self.nodes, "tensor": self.tensors, "input": inputs, "output": outputs}
        said = [{"key": key.encode(), "value": value.encode()} for key, value in metadata.items()]
        model = _model_class()(ir_version=IR_VERSION, opset=[{"version": OPSET}], graph=graph, metadata=said)
        return bytes(model.SerializeToString(deterministic=True))


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs) -> bytes:
    """The content of a file; the same network makes the same bytes."""
    network = network.eval().cpu()
    graph, cells = OnnxGraph(), specs.grid.cells
    weight, bias = _folded(network.encoder[0], network.encoder[1], 0)
    encoded = graph.add("Relu", graph.add("Add", graph.add("MatMul", "features", weight.T), bias))
    empty = graph.add("ConstantOfShape", np.array([cells * cells, WIDTH]))
    canvas = graph.add("ScatterND", empty, "pillar", encoded, reduction=b"max")
    image = graph.add("Reshape", graph.add("Transpose", canvas, perm=[1, 0]), np.array([1, WIDTH, cells, cells]))
    total = ""
    for block, up in zip(network.blocks, network.ups, strict=True):
        image = convolutions(graph, image, block)
        convolution, norm = _parts(up)
        stride = list(convolution.stride)
        raised = graph.add("ConvTranspose", image, *_folded(convolution, norm, 1), strides=stride, kernel_shape=stride)
        total = graph.add("Add", total, raised) if total else raised
    last = [numbers(network.last.weight), numbers(network.last.bias)]
    graph.add("Conv", convolutions(graph, graph.add("Relu", total), network.head), *last)
    side = cells // STRIDE
    inputs = [value(INPUTS[0], FLOAT, "points", len(FEATURES)), value(INPUTS[1], INT64, "points", 1)]
    outputs = [value("numbers", FLOAT, 1, len(specs.classes) + BOX_NUMBERS, side, side)]
    return graph.to_bytes("pillars", inputs, outputs, {KEY: specs.model_dump_json()})


def convolutions(graph: OnnxGraph, image: str, layers: nn.Module) -> str:
    """Add convolutions of 3 x 3, each with its normalisation and ReLU; the name of what comes of an image."""
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
    scale = numbers(norm.weight) / np.sqrt(numbers(norm.running_var) + norm.eps)
    weight = numbers(layer.weight)
    shape = [1] * weight.ndim
    shape[axis] = -1
    return weight * scale.reshape(shape), numbers(norm.bias) - numbers(norm.running_mean) * scale


def numbers(tensor: Any) -> Array:
    """Weights as an array."""
    return np.asarray(tensor.detach().to(torch.float64).numpy())


def value(name: str, kind: int, *dims: int | str) -> dict[str, Any]:
    """An input or output; dimensions with names are free."""
    shape = [{"name": one.encode()} if isinstance(one, str) else {"size": one} for one in dims]
    return {"name": name.encode(), "type": {"tensor": {"kind": kind, "shape": {"dims": shape}}}}


@cache
def _model_class() -> Any:
    return model_class("lidcam.pillars", FIELDS)
