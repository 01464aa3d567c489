"""Networks whose input has a fixed size, made to take others.

An export fixes the size of the input only in what it says of its inputs and outputs, where the network itself is made
of convolutions: with those statements changed it takes any multiple of its stride. Networks that hold tables for one
size (anchors, embeddings of positions) fail at the others, which a trial run shows.
"""

from typing import Any

from pipeline.core.errors import ModelError

__all__ = ["free_size"]


def free_size(graph: Any, input_name: str) -> None:
    """Make a graph say no longer how high and wide its image is, nor the shape of anything behind it.

    Args:
        graph: Of an ONNX file (`read_model`); it is changed.
        input_name: Its image, (N, C, H, W).

    Raises:
        ModelError: it has no such input.
    """
    images = [value for value in graph.inputs if value.name == input_name.encode()]
    if len(images) != 1 or len(images[0].type.tensor.shape.dims) != 4:
        raise ModelError(f"expected an input {input_name} of four dimensions")
    for dim, name in zip(images[0].type.tensor.shape.dims[2:], (b"height", b"width"), strict=True):
        dim.ClearField("size")
        dim.name = name
    for value in graph.outputs:
        value.type.tensor.ClearField("shape")
    del graph.inner[:]
