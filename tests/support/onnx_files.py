"""ONNX files for tests, of opset 11.

The network is a YOLOX in shape only: each output row is `bias + brightness * weight`, where brightness is the weighted
mean of the input's channels, so that what comes out depends on what goes in and is known by hand.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import NodeProto, TensorProto, ValueInfoProto, helper

from lidcam.pipeline.core.arrays import Array

FLOAT, DOUBLE, INT64, FLOAT16 = 1, 11, 7, 10


def write_yolox(
    path: Path,
    bias: Array,
    *,
    size_px: tuple[int, int],
    batch: int | str = 1,
    weight: Array | None = None,
    channel_weights: Sequence[float] = (1 / 3, 1 / 3, 1 / 3),
    outputs: int = 1,
    dtype: int = FLOAT,
) -> Path:
    """Write a network with input (batch, channels, *size_px) and output (batch, *bias.shape).

    `batch` is a number or the name of a free dimension; `outputs` repeats the output.
    """
    real = np.float64 if dtype == DOUBLE else np.float32
    weight = np.zeros_like(bias) if weight is None else weight
    channels = len(channel_weights)
    nodes = [
        _node("ReduceMean", ["images"], "means", axes=[2, 3], keepdims=0),
        _node("MatMul", ["means", "channel_weights"], "brightness"),
        _node("Unsqueeze", ["brightness"], "column", axes=[2]),
        _node("Mul", ["column", "weight"], "gain"),
        *(_node("Add", ["gain", "bias"], f"output{i}") for i in range(outputs)),
    ]
    constants = {
        "channel_weights": np.array(channel_weights, real)[:, None],
        "weight": weight[None].astype(real),
        "bias": bias[None].astype(real),
    }
    tensors = [_tensor(name, array, dtype) for name, array in constants.items()]
    stated = [_value(f"output{i}", (batch, *bias.shape), dtype) for i in range(outputs)]
    return write_model(path, nodes, tensors, [_value("images", (batch, channels, *size_px), dtype)], stated)


def write_model(
    path: Path,
    nodes: Sequence[NodeProto],
    constants: Sequence[TensorProto],
    inputs: Sequence[ValueInfoProto],
    outputs: Sequence[ValueInfoProto],
    *,
    metadata: Mapping[str, str] | None = None,
    inner: Sequence[ValueInfoProto] = (),
    domain: str = "",
) -> Path:
    """Write a network of parts; `inner` states the shapes of values between its nodes, `domain` has more operators."""
    graph = helper.make_graph(nodes, "network", inputs, outputs, constants, value_info=inner)
    versions = {"": 11} | ({domain: 1} if domain else {})
    operators = [helper.make_opsetid(name, version) for name, version in versions.items()]
    model = helper.make_model(graph, opset_imports=operators, ir_version=6)
    helper.set_model_props(model, dict(metadata or {}))
    path.write_bytes(model.SerializeToString())
    return path


def _node(op: str, inputs: Sequence[str], output: str, **attributes: Any) -> NodeProto:
    return helper.make_node(op, inputs, [output], **attributes)


def _tensor(name: str, array: Array, dtype: int) -> TensorProto:
    return helper.make_tensor(name, dtype, array.shape, array.tobytes(), raw=True)


def _value(name: str, shape: Sequence[int | str], dtype: int) -> ValueInfoProto:
    return helper.make_tensor_value_info(name, dtype, shape)
