"""ONNX files written node by node: PyTorch's exporters decide on names and order of the weights themselves."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from onnx import NodeProto, TensorProto, helper, numpy_helper

from lidcam.pipeline.core.arrays import Array

FLOAT, INT64 = int(TensorProto.FLOAT), int(TensorProto.INT64)
IR_VERSION, OPSET = 8, 18

Value = tuple[str, int, Sequence[int | str]]
"""Name, type of the elements, and dimensions of an input or output; free dimensions have names."""


class Graph:
    """Nodes in the order in which they run, and their constants."""

    def __init__(self) -> None:
        self._nodes: list[NodeProto] = []
        self._constants: list[TensorProto] = []

    def add_node(self, op: str, *inputs: str | Array, name: str = "", **attributes: Any) -> str:
        """Add a node and return the name of its output.

        Args:
            op: Operator.
            inputs: Names of outputs, or constants: whole numbers become int64, others float32.
            name: Name of the output; empty: make one. The second output of TopK has this name and `.second`.
            attributes: Attributes of the node.
        """
        name = name or f"{op}{len(self._nodes)}"
        names = []
        for row, value in enumerate(inputs):
            if not isinstance(value, str):
                array = np.ascontiguousarray(value, np.int64 if value.dtype.kind == "i" else np.float32)
                value = f"{name}.{row}"
                self._constants.append(numpy_helper.from_array(array, value))
            names.append(value)
        outputs = [name, f"{name}.second"] if op == "TopK" else [name]
        self._nodes.append(helper.make_node(op, names, outputs, **attributes))
        return name

    def file(self, inputs: Sequence[Value], outputs: Sequence[Value], metadata: Mapping[str, str]) -> bytes:
        """Content of a file with this graph; the same graph gives the same bytes."""
        ins, outs = ([helper.make_tensor_value_info(*one) for one in values] for values in (inputs, outputs))
        graph = helper.make_graph(self._nodes, "lidcam", ins, outs, self._constants)
        model = helper.make_model(graph, ir_version=IR_VERSION, opset_imports=[helper.make_opsetid("", OPSET)])
        for key, text in metadata.items():
            model.metadata_props.add(key=key, value=text)
        return bytes(model.SerializeToString(deterministic=True))
