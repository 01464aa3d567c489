"""ONNX files for tests, written byte by byte (protobuf wire format, field numbers of onnx.proto3, opset 11).

The network is a YOLOX in shape only: each output row is `bias + brightness * weight`, where brightness is the weighted
mean of the input's channels, so that what comes out depends on what goes in and is known by hand.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import Array

FLOAT, DOUBLE = 1, 11
ATTRIBUTE_INT, ATTRIBUTE_INTS = 2, 7


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
        _node("ReduceMean", ["images"], "means", _ints("axes", [2, 3]), _int("keepdims", 0)),
        _node("MatMul", ["means", "channel_weights"], "brightness"),
        _node("Unsqueeze", ["brightness"], "column", _ints("axes", [2])),
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
    nodes: Sequence[bytes],
    constants: Sequence[bytes],
    inputs: Sequence[bytes],
    outputs: Sequence[bytes],
    *,
    metadata: Mapping[str, str] | None = None,
    inner: Sequence[bytes] = (),
) -> Path:
    """Write a network of parts; `inner` states the shapes of values between its nodes."""
    graph = b"".join(_bytes(1, node) for node in nodes) + _bytes(2, b"network")
    for number, parts in ((5, constants), (11, inputs), (12, outputs), (13, inner)):
        graph += b"".join(_bytes(number, part) for part in parts)
    entries = [_bytes(1, key.encode()) + _bytes(2, value.encode()) for key, value in (metadata or {}).items()]
    said = b"".join(_bytes(14, entry) for entry in entries)
    path.write_bytes(_varint_field(1, 6) + _bytes(8, _varint_field(2, 11)) + _bytes(7, graph) + said)
    return path


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _varint_field(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _bytes(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _int(name: str, value: int) -> bytes:
    return _bytes(1, name.encode()) + _varint_field(3, value) + _varint_field(20, ATTRIBUTE_INT)


def _ints(name: str, values: Sequence[int]) -> bytes:
    return _bytes(1, name.encode()) + b"".join(_varint_field(8, v) for v in values) + _varint_field(20, ATTRIBUTE_INTS)


def _node(op: str, inputs: Sequence[str], output: str, *attributes: bytes) -> bytes:
    return (
        b"".join(_bytes(1, name.encode()) for name in inputs)
        + _bytes(2, output.encode())
        + _bytes(4, op.encode())
        + b"".join(_bytes(5, attribute) for attribute in attributes)
    )


def _tensor(name: str, array: Array, dtype: int) -> bytes:
    dims = b"".join(_varint_field(1, n) for n in array.shape)
    return dims + _varint_field(2, dtype) + _bytes(8, name.encode()) + _bytes(9, array.tobytes())


def _value(name: str, shape: Sequence[int | str], dtype: int) -> bytes:
    dims = b"".join(_bytes(1, _varint_field(1, n) if isinstance(n, int) else _bytes(2, n.encode())) for n in shape)
    return _bytes(1, name.encode()) + _bytes(2, _bytes(1, _varint_field(1, dtype) + _bytes(2, dims)))
