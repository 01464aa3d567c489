"""A trained network as an ONNX file, and back."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lidcam.pipeline.core.arrays import F32
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS
from lidcam.pipeline.detectors.pillars.grid import FEATURES, STRIDE, Grid
from lidcam.pipeline.detectors.pillars.network import INPUTS, KEY, PillarSpecs
from lidcam.pipeline.detectors.pillars.network import PillarNetwork as WrittenNetwork
from lidcam.training.onnx_graph import FLOAT, INT64, Graph, numbers_in
from lidcam.training.onnx_layers import convolution, convolutions, normalised, parameters, tensors
from lidcam.training.pillars.network import WIDTH, PillarNetwork


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs, learned: Grid) -> bytes:
    """The content of a file; the same network gives the same bytes.

    Args:
        network: The network.
        specs: What the file says about it. The grid may be larger than the one it learned in, because convolutions are
            the same everywhere.
        learned: The grid that it learned in.
    """
    network = network.eval().cpu()
    graph, cells = Graph(), specs.grid.cells
    encoder: list[Any] = [*network.encoder]
    blocks: list[Any] = [*network.blocks]
    ups: list[Any] = [*network.ups]
    linear, norm, _ = encoder
    weight = parameters(linear)[0].T * _told_distance(specs.grid, learned)
    encoded = graph.add("Relu", normalised(graph, graph.add("MatMul", "features", weight), norm))
    empty = graph.add("ConstantOfShape", np.array([cells * cells, WIDTH]))
    canvas = graph.add("ScatterND", empty, "pillar", encoded, reduction=b"max")
    image = graph.add("Reshape", graph.add("Transpose", canvas, perm=[1, 0]), np.array([1, WIDTH, cells, cells]))
    total = ""
    for block, up in zip(blocks, ups, strict=True):
        image = convolutions(graph, image, block)
        layer, norm = up
        stride = [*layer.stride]
        raised = graph.add("ConvTranspose", image, *parameters(layer), strides=stride, kernel_shape=stride)
        raised = normalised(graph, raised, norm)
        total = graph.add("Add", total, raised) if total else raised
    convolution(graph, convolutions(graph, graph.add("Relu", total), network.head), network.last, name="numbers")
    side = cells // STRIDE
    inputs = (INPUTS[0], FLOAT, ("points", len(FEATURES))), (INPUTS[1], INT64, ("points", 1))
    outputs = [("numbers", FLOAT, (1, len(specs.classes) + BOX_NUMBERS, side, side))]
    return graph.file(inputs, outputs, {KEY: specs.model_dump_json()})


def take_weights(network: PillarNetwork, file: Path, classes: Sequence[str], learned: Grid) -> None:
    """Load the weights of a file from `onnx_bytes` into a network.

    Args:
        network: The network to change.
        file: The file.
        classes: What the network finds.
        learned: The grid that it learns in.

    Raises:
        ModelError: the file cannot be read, or holds another kind of network.
    """
    specs = WrittenNetwork(file).specs
    wanted = f"{file}: expected a network of this version of lidcam that finds {', '.join(classes)} in pillars of"
    found, cell_m = [one.name for one in specs.classes], specs.grid.cell_m
    if found != [*classes] or cell_m != learned.cell_m:
        raise ModelError(f"{wanted} {learned.cell_m:g} m, found {', '.join(found)} in {cell_m:g} m")
    pairs = zip(network.blocks, network.ups, strict=True)
    parts: list[Any] = [network.encoder, *(part for pair in pairs for part in pair), network.head, [network.last]]
    places = [one for part in parts for layer in part for one in tensors(layer)]
    numbers = numbers_in(file.read_bytes())
    if [one.shape for one in numbers] != [places[0].T.shape, *(one.shape for one in places[1:])]:
        raise ModelError(f"{wanted} {learned.cell_m:g} m, found one with other layers: train it anew")
    numbers[0] = (numbers[0] / _told_distance(specs.grid, learned)).T
    with torch.no_grad():
        for place, values in zip(places, numbers, strict=True):
            place.copy_(torch.from_numpy(values.copy()))


def _told_distance(written: Grid, learned: Grid) -> F32:
    """(F, 1) factors of weights by feature, because the distance is measured in half sides of the grid."""
    factors = np.ones((len(FEATURES), 1), np.float32)
    factors[FEATURES.index("distance")] = written.half_m / learned.half_m
    return factors
