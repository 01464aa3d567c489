"""A trained network as an ONNX file, with the outputs of YOLOX, which `pipeline.detectors.onnx` reads."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidcam.training.images.network import ImageNetwork
from lidcam.training.pillars.onnx_file import FLOAT, OnnxGraph, convolutions, numbers, value

__all__ = ["onnx_bytes"]


def onnx_bytes(network: ImageNetwork, classes: Sequence[str]) -> bytes:
    """The content of a file, its weights in half precision; the same network makes the same bytes."""
    graph, image, found = OnnxGraph(half=True), "images", []
    for block, lateral in zip(network.blocks, network.laterals, strict=True):
        image = convolutions(graph, image, block)
        found.append(_cellwise(graph, image, lateral))
    total, rows = "", []
    for own in reversed(found):
        # Pixels are repeated, as in the training.
        total = graph.add("Add", own, _doubled(graph, total)) if total else own
        said = _cellwise(graph, convolutions(graph, graph.add("Relu", total), network.head), network.last)
        rows.append(graph.add("Reshape", said, np.array([0, 5 + len(classes), -1])))
    joined = graph.add("Transpose", graph.add("Concat", *rows[::-1], axis=2), perm=[0, 2, 1])
    boxes, is_there, kinds = (
        graph.add("Slice", joined, np.array([first]), np.array([end]), np.array([2]))
        for first, end in ((0, 4), (4, 5), (5, 5 + len(classes)))
    )
    graph.add("Concat", boxes, graph.add("Sigmoid", is_there), graph.add("Softmax", kinds, axis=2), axis=2)
    names = ", ".join(f"{row}: {name}" for row, name in enumerate(classes))
    shape = "batch", "cells", 5 + len(classes)
    images = value("images", FLOAT, "batch", 3, "height", "width")
    return graph.to_bytes("images", [images], [value("boxes", FLOAT, *shape)], {"names": f"{{{names}}}"})


def _cellwise(graph: OnnxGraph, image: str, layer: Any) -> str:
    return graph.add("Conv", image, numbers(layer.weight), numbers(layer.bias))


def _doubled(graph: OnnxGraph, image: str) -> str:
    scales = np.array([1.0, 1.0, 2.0, 2.0])
    floor = {"mode": b"nearest", "coordinate_transformation_mode": b"asymmetric", "nearest_mode": b"floor"}
    return graph.add("Resize", image, "", scales, **floor)
