"""The parts of ONNX files that are looked at or changed here.

Field numbers: onnx.proto3 of github.com/onnx/onnx. Fields that are not named here stay as they are.
"""

from collections import Counter
from functools import cache
from math import prod
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, EncodeError, Message
from google.protobuf.message_factory import GetMessageClass

from pipeline.core.arrays import F32
from pipeline.core.errors import ModelError

__all__ = ["FLOAT", "INTS", "Wiring", "attributes_of", "read_model", "written_model"]

ONE, MANY = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
FIELDS = {
    "Model": [("graph", 7, ONE, "Graph")],
    "Graph": [
        ("nodes", 1, MANY, "Node"),
        ("constants", 5, MANY, "Constant"),
        ("inputs", 11, MANY, "Value"),
        ("outputs", 12, MANY, "Value"),
        ("inner", 13, MANY, "Value"),
    ],
    "Node": [
        ("inputs", 1, MANY, "bytes"),
        ("outputs", 2, MANY, "bytes"),
        ("op", 4, ONE, "bytes"),
        ("attributes", 5, MANY, "Attribute"),
        ("domain", 7, ONE, "bytes"),
    ],
    "Attribute": [
        ("name", 1, ONE, "bytes"),
        ("int", 3, ONE, "int64"),
        ("text", 4, ONE, "bytes"),
        ("constant", 5, ONE, "Constant"),
        ("graph", 6, ONE, "bytes"),
        ("ints", 8, MANY, "int64"),
        ("graphs", 11, MANY, "bytes"),
        ("kind", 20, ONE, "int64"),
    ],
    "Constant": [
        ("dims", 1, MANY, "int64"),
        ("kind", 2, ONE, "int64"),
        ("int64s", 7, MANY, "int64"),
        ("name", 8, ONE, "bytes"),
        ("raw", 9, ONE, "bytes"),
    ],
    "Value": [("name", 1, ONE, "bytes"), ("type", 2, ONE, "Type")],
    "Type": [("tensor", 1, ONE, "Tensor")],
    "Tensor": [("shape", 2, ONE, "Shape")],
    "Shape": [("dims", 1, MANY, "Dim")],
    "Dim": [("size", 1, ONE, "int64"), ("name", 2, ONE, "bytes")],
}
PLAIN = {"bytes": FieldDescriptorProto.TYPE_BYTES, "int64": FieldDescriptorProto.TYPE_INT64}

INT, TEXT, CONSTANT = 2, 3, 4
INTS = 7
"""Kinds of attributes."""

FLOAT = 1
INT64 = 7
"""Kinds of constants."""


class Wiring:
    """What a graph's nodes take from each other, by the names of values.

    Attributes:
        maker: Row of the node that makes a value.
        uses: How often a value is taken, as an output of the graph too.
        is_flat: Whether no node holds a graph, which could take values, too.
    """

    def __init__(self, graph: Any) -> None:
        self._nodes = graph.nodes
        self.maker: dict[bytes, int] = {name: row for row, node in enumerate(graph.nodes) for name in node.outputs}
        self.uses = Counter[bytes](name for node in graph.nodes for name in node.inputs)
        self.uses.update(value.name for value in graph.outputs)
        given = {value.name for value in graph.inputs}  # who runs it may replace what stands there as well
        self._constants = {one.name: one for one in graph.constants if one.name not in given}
        self.is_flat = not any(one.graph or one.graphs for node in graph.nodes for one in node.attributes)

    def made_by(self, name: bytes, op: bytes) -> Any:
        """The node that makes a value; None if another one does than is asked for, or none."""
        node = self._nodes[self.maker[name]] if name in self.maker else None
        return node if node is not None and node.op == op and not node.domain else None

    def only_for(self, name: bytes) -> list[int]:
        """Rows of the nodes that nothing needs once what took a value last takes it no more."""
        uses, names, rows = self.uses.copy(), [name], []
        while names:
            name = names.pop()
            uses[name] -= 1
            row = self.maker.get(name)
            if row is not None and not any(uses[one] for one in self._nodes[row].outputs):
                rows.append(row)
                names.extend(self._nodes[row].inputs)
        return rows

    def int64s(self, name: bytes) -> list[int]:
        """What a constant of whole numbers (int64) holds; nothing if it is no such constant."""
        constant = self._constant(name)
        if constant is None or constant.kind != INT64 or len(constant.raw) % 8:
            return []
        return list(constant.int64s) or np.frombuffer(constant.raw, "<i8").tolist()

    def floats(self, name: bytes) -> F32 | None:
        """A constant of single precision that lies in the file as it is in memory; None if it is no such constant."""
        constant = self._constant(name)
        if constant is None or constant.kind != FLOAT or len(constant.raw) != 4 * prod(constant.dims):
            return None
        return np.frombuffer(constant.raw, "<f4").reshape(constant.dims)

    def _constant(self, name: bytes) -> Any:
        node = self.made_by(name, b"Constant")
        return self._constants.get(name) if node is None else attributes_of(node).get("value")


def attributes_of(node: Any) -> dict[str, Any]:
    """The attributes of a node by name, as far as they are of kinds that are named here."""
    fields = {INT: "int", TEXT: "text", CONSTANT: "constant", INTS: "ints"}
    told = {one.name.decode(errors="replace"): (one, fields.get(one.kind)) for one in node.attributes}
    return {name: _plain(getattr(one, field)) if field else None for name, (one, field) in told.items()}


def _plain(value: Any) -> Any:
    return value if isinstance(value, int | bytes | Message) else list(value)


def read_model(data: bytes) -> Any:
    """A file's content.

    Raises:
        ModelError: protobuf cannot read it.
    """
    try:
        return _message_class().FromString(data)
    except DecodeError as err:
        raise ModelError(f"expected an ONNX file that can be changed: {err}") from err


def written_model(model: Any) -> bytes:
    """The content as a file.

    Raises:
        ModelError: it is too large for protobuf.
    """
    try:
        return bytes(model.SerializeToString(deterministic=True))
    except EncodeError as err:
        raise ModelError(f"expected an ONNX file that can be changed: {err}") from err


@cache
def _message_class() -> Any:
    """Reads what is named in `FIELDS`, and keeps the bytes of all other fields."""
    package = "lidcam.onnx"
    file = FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto2")
    for message, fields in FIELDS.items():
        described = file.message_type.add(name=message)
        for name, number, label, kind in fields:
            field = described.field.add(name=name, number=number, label=label)
            if kind in PLAIN:
                field.type = PLAIN[kind]
            else:
                field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{package}.{kind}"
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{package}.Model"))
