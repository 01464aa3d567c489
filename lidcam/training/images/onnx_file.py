"""A trained network as an ONNX file, with the outputs of YOLOX, which `lidcam.pipeline.detectors.onnx` reads."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidcam.training.images.network import ImageNetwork
from lidcam.training.onnx_graph import FLOAT, Graph
from lidcam.training.onnx_layers import convolution, convolutions


def onnx_bytes(network: ImageNetwork, classes: Sequence[str]) -> bytes:
    """The content of a file with weights in half precision; the same network gives the same bytes."""
    graph, image, found = Graph(half=True), "images", []
    blocks: list[Any] = [*network.blocks]
    laterals: list[Any] = [*network.laterals]
    for block, lateral in zip(blocks, laterals, strict=True):
        image = convolutions(graph, image, block)
        found.append(convolution(graph, image, lateral))
    total, rows = "", []
    heads: list[Any] = [*network.heads]
    for own, head in zip(found[::-1], heads[::-1], strict=True):
        # Enlarge by repeating pixels, as in the training.
        total = graph.add("Add", own, _doubled(graph, total)) if total else own
        *convolved, last = head
        said = convolution(graph, convolutions(graph, graph.add("Relu", total), convolved), last)
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


def _doubled(graph: Graph, image: str) -> str:
    scales = np.array([1.0, 1.0, 2.0, 2.0])
    to_pixel = b"asymmetric"
    return graph.add(
        "Resize", image, "", scales, mode=b"nearest", coordinate_transformation_mode=to_pixel, nearest_mode=b"floor"
    )
