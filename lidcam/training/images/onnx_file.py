"""A trained network as an ONNX file, with the outputs of YOLOX, which `pipeline.detectors.onnx` reads."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from torch import nn
from torch.nn.utils import fuse_conv_bn_eval

from lidcam.training.images.network import ImageNetwork
from lidcam.training.onnx_graph import FLOAT, Graph

__all__ = ["onnx_bytes"]


def onnx_bytes(network: ImageNetwork, classes: Sequence[str]) -> bytes:
    """The content of a file, its weights in half precision; the same network makes the same bytes."""
    graph, image, found = Graph(half=True), "images", []
    blocks: list[Any] = [*network.blocks]
    laterals: list[Any] = [*network.laterals]
    for block, lateral in zip(blocks, laterals, strict=True):
        image = _convolutions(graph, image, block)
        found.append(_convolution(graph, image, lateral))
    total, rows = "", []
    heads: list[Any] = [*network.heads]
    for own, head in zip(found[::-1], heads[::-1], strict=True):
        # Pixels are repeated, as in the training.
        total = graph.add("Add", own, _doubled(graph, total)) if total else own
        *convolved, last = head
        said = _convolution(graph, _convolutions(graph, graph.add("Relu", total), convolved), last)
        rows.append(graph.add("Reshape", said, np.array([0, 5 + len(classes), -1])))
    joined = graph.add("Transpose", graph.add("Concat", *rows[::-1], axis=2), perm=[0, 2, 1])
    boxes, is_there, kinds = (
        graph.add("Slice", joined, np.array([first]), np.array([end]), np.array([2]))
        for first, end in ((0, 4), (4, 5), (5, 5 + len(classes)))
    )
    graph.add(
        "Concat", boxes, graph.add("Sigmoid", is_there), graph.add("Softmax", kinds, axis=2), axis=2, name="boxes"
    )
    names = ", ".join(f"{row}: {name}" for row, name in enumerate(classes))
    inputs = [("images", FLOAT, ("batch", 3, "height", "width"))]
    outputs = [("boxes", FLOAT, ("batch", "cells", 5 + len(classes)))]
    return graph.file(inputs, outputs, {"names": f"{{{names}}}"})


def _convolutions(graph: Graph, image: str, layers: Iterable[Any]) -> str:
    parts = [*layers]
    for convolution, norm in zip(parts[::3], parts[1::3], strict=True):
        image = graph.add("Relu", _convolution(graph, image, fuse_conv_bn_eval(convolution, norm)))
    return image


def _convolution(graph: Graph, image: str, layer: nn.Conv2d) -> str:
    weights = [np.asarray(one.detach().numpy()) for one in (layer.weight, layer.bias) if one is not None]
    return graph.add("Conv", image, *weights, strides=[*layer.stride], pads=[*layer.padding] * 2)


def _doubled(graph: Graph, image: str) -> str:
    scales = np.array([1.0, 1.0, 2.0, 2.0])
    to_pixel = b"asymmetric"
    return graph.add(
        "Resize", image, "", scales, mode=b"nearest", coordinate_transformation_mode=to_pixel, nearest_mode=b"floor"
    )
