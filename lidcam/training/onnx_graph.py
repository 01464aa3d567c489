"""ONNX files as lists of nodes.

They are written with protobuf messages, because PyTorch's exporters need more packages.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32, Array
from lidcam.pipeline.detectors.onnx.messages import MANY, ONE, model_class

Value = tuple[str, int, Sequence[int | str]]
"""Name, type of the elements, and dimensions of an input or output; free dimensions have names."""

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
"""The fields of onnx.proto3 (github.com/onnx/onnx) that are used here."""

IR_VERSION, OPSET = 8, 18
FLOAT, INT64, HALF = 1, 7, 10
INT, TEXT, INTS = 2, 3, 7


class Graph:
    """Nodes in the order in which they run, and their constants."""

    def __init__(self, prefix: str = "", *, half: bool = False) -> None:
        """Start an empty graph.

        Args:
            prefix: Prefix of all names, for nodes that follow those of another file.
            half: Whether the file stores numbers in half precision, for half the size; it computes in single.
        """
        self._prefix, self._half = prefix, half
        self._nodes: list[dict[str, Any]] = []
        self._tensors: list[dict[str, Any]] = []

    def add(self, op: str, *inputs: str | Array, name: str = "", **attributes: int | list[int] | bytes) -> str:
        """Add a node and return the name of its output; inputs are names, or constants.

        Args:
            op: What the node does.
            inputs: Inputs of the node.
            name: Name of the output; empty: make one. The name of a second output ends in `.second`.
            attributes: Attributes of the node.
        """
        name = name or f"{self._prefix}{op}{len(self._nodes)}"
        names = [
            (one if isinstance(one, str) else self._constant(f"{name}.{row}", one)).encode()
            for row, one in enumerate(inputs)
        ]
        said = [{"name": key.encode()} | _attribute(value) for key, value in attributes.items()]
        outputs = [name.encode()] + [f"{name}.second".encode()] * (op == "TopK")
        self._nodes.append({"op": op.encode(), "input": names, "output": outputs, "attribute": said})
        return name

    def _constant(self, name: str, array: Array) -> str:
        is_whole = array.dtype.kind == "i"
        is_half = self._half and not is_whole
        data = np.ascontiguousarray(array, "<i8" if is_whole else "<f2" if is_half else "<f4")
        kind = INT64 if is_whole else HALF if is_half else FLOAT
        self._tensors.append({"name": name.encode(), "dims": data.shape, "type": kind, "data": data.tobytes()})
        return self.add("Cast", name, to=FLOAT) if is_half else name

    def file(self, inputs: Sequence[Value], outputs: Sequence[Value], metadata: Mapping[str, str]) -> bytes:
        """The content of a file with this graph; the same graph gives the same bytes."""
        graph = {"name": b"lidcam", "input": [*map(_value, inputs)]}
        model = _model_class()(ir_version=IR_VERSION, opset=[{"version": OPSET}], graph=graph)
        return self._written(model, outputs, metadata)

    def file_behind(self, file: bytes, outputs: Sequence[Value], metadata: Mapping[str, str]) -> bytes:
        """The content of a file with this graph appended to its own.

        Raises:
            google.protobuf.message.DecodeError: it is not an ONNX file.
        """
        model = _model_class().FromString(file)
        del model.graph.output[:]
        return self._written(model, outputs, metadata)

    def _written(self, model: Any, outputs: Sequence[Value], metadata: Mapping[str, str]) -> bytes:
        model.MergeFrom(
            _model_class()(
                graph={"node": self._nodes, "tensor": self._tensors, "output": [*map(_value, outputs)]},
                metadata=[{"key": key.encode(), "value": text.encode()} for key, text in metadata.items()],
            )
        )
        return bytes(model.SerializeToString(deterministic=True))


def numbers_in(file: bytes) -> list[F32]:
    """The constants of a file in single precision, in the order of the file.

    Raises:
        google.protobuf.message.DecodeError: it is not an ONNX file.
    """
    found = [one for one in _model_class().FromString(file).graph.tensor if one.type == FLOAT]
    return [np.frombuffer(one.data, "<f4").reshape(tuple(one.dims)) for one in found]


def _attribute(value: int | list[int] | bytes) -> dict[str, Any]:
    if isinstance(value, bytes):
        return {"text": value, "type": TEXT}
    return {"int": value, "type": INT} if isinstance(value, int) else {"ints": value, "type": INTS}


def _value(value: Value) -> dict[str, Any]:
    name, kind, dims = value
    shape = [{"name": one.encode()} if isinstance(one, str) else {"size": one} for one in dims]
    return {"name": name.encode(), "type": {"tensor": {"kind": kind, "shape": {"dims": shape}}}}


@cache
def _model_class() -> Any:
    return model_class("lidcam.pillars", FIELDS)
