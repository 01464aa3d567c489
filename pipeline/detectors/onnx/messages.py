"""Messages of onnx.proto3 (github.com/onnx/onnx), as far as lidcam reads or writes them."""

from collections.abc import Mapping, Sequence
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

ONE, MANY = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
PLAIN = {"bytes": FieldDescriptorProto.TYPE_BYTES, "int64": FieldDescriptorProto.TYPE_INT64}

Fields = Mapping[str, Sequence[tuple[str, int, "FieldDescriptorProto.Label.ValueType", str]]]
"""By message its fields: name, number, `ONE` or `MANY`, and type, which is one of `PLAIN` or another message."""


def model_class(package: str, messages: Fields) -> Any:
    """The class of the message `Model`, which reads the fields that are named, and keeps the bytes of all others.

    Args:
        package: Its name, another one for other fields.
        messages: All messages that it consists of.
    """
    file = FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto2")
    for message, fields in messages.items():
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
