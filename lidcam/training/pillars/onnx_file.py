"""A trained network as an ONNX file. Normalisation is folded into the layer before it."""

from typing import Any

import numpy as np
import torch
from torch import nn

from lidcam.training.onnx_graph import FLOAT, INT64, Graph
from lidcam.training.pillars.network import WIDTH, PillarNetwork
from pipeline.core.arrays import Array
from pipeline.detectors.pillars.decoding import BOX_NUMBERS
from pipeline.detectors.pillars.grid import FEATURES, STRIDE
from pipeline.detectors.pillars.network import INPUTS, KEY, PillarSpecs

__all__ = ["onnx_bytes"]


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs) -> bytes:
    """The content of a file; the same network makes the same bytes."""
    network = network.eval().cpu()
    graph, cells = Graph(), specs.grid.cells
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
    graph.add("Conv", _convolutions(graph, graph.add("Relu", total), network.head), *last, name="numbers")
    side = cells // STRIDE
    inputs = (INPUTS[0], FLOAT, ("points", len(FEATURES))), (INPUTS[1], INT64, ("points", 1))
    outputs = [("numbers", FLOAT, (1, len(specs.classes) + BOX_NUMBERS, side, side))]
    return graph.file(inputs, outputs, {KEY: specs.model_dump_json()})


def _convolutions(graph: Graph, image: str, layers: nn.Module) -> str:
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
