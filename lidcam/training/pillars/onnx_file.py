"""A trained network as an ONNX file."""

from typing import Any

import numpy as np
from torch.nn.utils import fuse_conv_bn_eval, fuse_linear_bn_eval

from lidcam.training.onnx_graph import FLOAT, INT64, Graph
from lidcam.training.onnx_layers import convolution, convolutions, parameters
from lidcam.training.pillars.network import WIDTH, PillarNetwork
from pipeline.detectors.pillars.decoding import BOX_NUMBERS
from pipeline.detectors.pillars.grid import FEATURES, STRIDE, Grid
from pipeline.detectors.pillars.network import INPUTS, KEY, PillarSpecs

__all__ = ["onnx_bytes"]


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs, learned: Grid) -> bytes:
    """The content of a file; the same network makes the same bytes.

    Args:
        network: The network.
        specs: What the file says of it. Its grid may be larger than the one learned in: convolutions are the same
            everywhere.
        learned: The grid that it learned in.
    """
    network = network.eval().cpu()
    graph, cells = Graph(), specs.grid.cells
    encoder: list[Any] = [*network.encoder]
    blocks: list[Any] = [*network.blocks]
    ups: list[Any] = [*network.ups]
    linear, norm, _ = encoder
    weight, bias = parameters(fuse_linear_bn_eval(linear, norm))
    weight[:, FEATURES.index("distance")] *= specs.grid.half_m / learned.half_m  # told in half sides of the grid
    encoded = graph.add("Relu", graph.add("Add", graph.add("MatMul", "features", weight.T), bias))
    empty = graph.add("ConstantOfShape", np.array([cells * cells, WIDTH]))
    canvas = graph.add("ScatterND", empty, "pillar", encoded, reduction=b"max")
    image = graph.add("Reshape", graph.add("Transpose", canvas, perm=[1, 0]), np.array([1, WIDTH, cells, cells]))
    total = ""
    for block, up in zip(blocks, ups, strict=True):
        image = convolutions(graph, image, block)
        layer, norm = up
        stride, folded = [*layer.stride], fuse_conv_bn_eval(layer, norm, transpose=True)
        raised = graph.add("ConvTranspose", image, *parameters(folded), strides=stride, kernel_shape=stride)
        total = graph.add("Add", total, raised) if total else raised
    convolution(graph, convolutions(graph, graph.add("Relu", total), network.head), network.last, name="numbers")
    side = cells // STRIDE
    inputs = (INPUTS[0], FLOAT, ("points", len(FEATURES))), (INPUTS[1], INT64, ("points", 1))
    outputs = [("numbers", FLOAT, (1, len(specs.classes) + BOX_NUMBERS, side, side))]
    return graph.file(inputs, outputs, {KEY: specs.model_dump_json()})
