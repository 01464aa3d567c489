"""Networks whose input has a fixed size, made to take others.

An export fixes the size of the input only in what it says of its inputs and outputs, where the network itself is made
of convolutions: with those statements changed it takes any multiple of its stride. Networks that hold tables for one
size (anchors, embeddings of positions) fail at the others, which a trial run shows.
"""

from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, EncodeError
from google.protobuf.message_factory import GetMessageClass

from lidcam.pipeline.core.errors import ModelError

PACKAGE = "lidcam.onnx"
ONE, MANY = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
PLAIN = {"bytes": FieldDescriptorProto.TYPE_BYTES, "int64": FieldDescriptorProto.TYPE_INT64}
FIELDS = {
    "Model": [("graph", 7, ONE, "Graph")],
    "Graph": [("inputs", 11, MANY, "Value"), ("outputs", 12, MANY, "Value"), ("inner", 13, MANY, "Value")],
    "Value": [("name", 1, ONE, "bytes"), ("type", 2, ONE, "Type")],
    "Type": [("tensor", 1, ONE, "Tensor")],
    "Tensor": [("shape", 2, ONE, "Shape")],
    "Shape": [("dims", 1, MANY, "Dim")],
    "Dim": [("size", 1, ONE, "int64"), ("name", 2, ONE, "bytes")],
}
"""The fields of onnx.proto3 (github.com/onnx/onnx) that are read or changed; the others keep their bytes."""


def free_size(data: bytes, input_name: str) -> bytes:
    """An ONNX file that no longer says how high and wide its image is, nor the shape of anything behind it.

    Args:
        data: The file.
        input_name: Its image, (N, C, H, W).

    Raises:
        ModelError: it has no such input, or protobuf cannot read it, or not write it.
    """
    try:
        model = _message_class().FromString(data)
        images = [value for value in model.graph.inputs if value.name == input_name.encode()]
        if len(images) != 1 or len(images[0].type.tensor.shape.dims) != 4:
            raise ModelError(f"expected an input {input_name} of four dimensions")
        for dim, name in zip(images[0].type.tensor.shape.dims[2:], (b"height", b"width"), strict=True):
            dim.ClearField("size")
            dim.name = name
        for value in model.graph.outputs:
            value.type.tensor.ClearField("shape")
        del model.graph.inner[:]
        return bytes(model.SerializeToString(deterministic=True))
    except (DecodeError, EncodeError) as err:
        raise ModelError(f"expected an ONNX file that can be changed: {err}") from err


@cache
def _message_class() -> Any:
    file = FileDescriptorProto(name=f"{PACKAGE}.proto", package=PACKAGE, syntax="proto2")
    for message, fields in FIELDS.items():
        described = file.message_type.add(name=message)
        for name, number, label, kind in fields:
            field = described.field.add(name=name, number=number, label=label)
            if kind in PLAIN:
                field.type = PLAIN[kind]
            else:
                field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{PACKAGE}.{kind}"
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.Model"))
