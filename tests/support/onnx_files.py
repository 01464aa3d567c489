"""ONNX files for tests, of opset 11, in ONNX's text form: networks of every layout, whose outputs are known by hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from onnx import helper, numpy_helper, parser

from lidcam.pipeline.core.arrays import Array

Shape = Sequence[int | str]
KINDS = {"float32": "float", "float64": "double", "int64": "int64", "float16": "float16"}


def value(name: str, shape: Shape, kind: str = "float") -> str:
    """An input or output in a graph's text."""
    return f"{kind}[{','.join(map(str, shape))}] {name}"


def write_model(
    path: Path, text: str, constants: Mapping[str, Array], metadata: Mapping[str, str] | None = None
) -> Path:
    """Write a network of a graph's text and its constants."""
    model = parser.parse_model(f'<ir_version: 6, opset_import: ["": 11]> network {text}')
    model.graph.initializer.extend(
        numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()
    )
    helper.set_model_props(model, dict(metadata or {}))
    path.write_bytes(model.SerializeToString())
    return path


def write_yolox(
    path: Path,
    bias: Array,
    *,
    size_px: tuple[int, int],
    batch: int | str = 1,
    weight: Array | None = None,
    channel_weights: Sequence[float] = (1 / 3, 1 / 3, 1 / 3),
    outputs: int = 1,
    kind: str = "float32",
) -> Path:
    """Write a YOLOX in shape only: input (batch, channels, *size_px), output (batch, *bias.shape).

    Each output row is `bias + brightness * weight`, where brightness is the weighted mean of the input's channels.
    `batch` is a number or the name of a free dimension; `outputs` repeats the output; `kind` is that of all numbers.
    """
    constants = {
        "channel_weights": np.array(channel_weights)[:, None],
        "weight": (np.zeros_like(bias) if weight is None else weight)[None],
        "bias": bias[None],
    }
    images = value("images", (batch, len(channel_weights), *size_px), KINDS[kind])
    stated = [value(f"output{row}", (batch, *bias.shape), KINDS[kind]) for row in range(outputs)]
    text = f"""({images}) => ({", ".join(stated)}) {{
        means = ReduceMean <axes = [2, 3], keepdims = 0> (images)
        brightness = MatMul (means, channel_weights)
        column = Unsqueeze <axes = [2]> (brightness)
        gain = Mul (column, weight)
        {" ".join(f"output{row} = Add (gain, bias)" for row in range(outputs))}
    }}"""
    return write_model(path, text, {name: array.astype(kind) for name, array in constants.items()})


def write_network(
    path: Path,
    outputs: Mapping[str, Array],
    *,
    size_px: Shape,
    batch: int | str = 1,
    kind: str = "float",
    scaled: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write a network that gives the same arrays for each image of a batch; those that are `scaled` by its sizes."""
    inputs, nodes = [value("images", (batch, 3, *size_px), kind)], []
    stated = [value(name, (batch, *array.shape), KINDS[str(array.dtype)]) for name, array in outputs.items()]
    if scaled:
        inputs.append(value("orig_target_sizes", (batch, 2), "int64"))
        nodes.append("""
            sizes = Cast <to = 1> (orig_target_sizes) sizes4 = Concat <axis = 1> (sizes, sizes)
            scale = Unsqueeze <axes = [1]> (sizes4)""")
    for name, array in outputs.items():
        axes = [*range(1, array.ndim + 1)]
        nodes.append(f"""
            {name}_column = Unsqueeze <axes = {axes}> (zero) {name}_sum = Add ({name}_column, {name}_held)
            {name}_all = {f"Mul ({name}_sum, scale)" if name in scaled else f"Identity ({name}_sum)"}
            {name} = Cast <to = {helper.np_dtype_to_tensor_dtype(array.dtype)}> ({name}_all)""")
    text = f"""({", ".join(inputs)}) => ({", ".join(stated)}) {{
        mean = ReduceMean <axes = [1, 2, 3], keepdims = 0> (images)
        real = Cast <to = 1> (mean) zero = Sub (real, real)
        {"".join(nodes)}
    }}"""
    held = {f"{name}_held": array[None].astype(np.float32) for name, array in outputs.items()}
    return write_model(path, text, held, metadata)


def write_convolutional(
    path: Path, kernels: Sequence[Array], biases: Sequence[Array], *, size_px: Sequence[int]
) -> Path:
    """Write a YOLOX of one convolution for each stride S, whose kernels (5 + C, 3, S, S) cover the cells.

    The file states one size, that of its input, as exports do, also between its nodes; it computes any other.
    """
    nodes, inner, cells, columns = [], [], 0, len(biases[0])
    constants: dict[str, Array] = {"rows": np.array([1, columns, -1])}
    for kernel, bias in zip(kernels, biases, strict=True):
        side = kernel.shape[-1]
        high, wide = (length // side for length in size_px)
        constants |= {f"kernel{side}": kernel.astype(np.float32), f"bias{side}": bias.astype(np.float32)}
        sides = f"kernel_shape = [{side}, {side}], strides = [{side}, {side}]"
        nodes.append(f"level{side} = Conv <{sides}> (images, kernel{side}, bias{side})")
        nodes.append(f"rows{side} = Reshape (level{side}, rows)")
        inner.append(value(f"level{side}", (1, columns, high, wide)))
        cells += high * wide
    levels = ", ".join(f"rows{kernel.shape[-1]}" for kernel in kernels)
    images, output = value("images", (1, 3, *size_px)), value("output", (1, cells, columns))
    text = f"""({images}) => ({output}) <{", ".join(inner)}> {{
        {" ".join(nodes)}
        joined = Concat <axis = 2> ({levels}) output = Transpose <perm = [0, 2, 1]> (joined)
    }}"""
    return write_model(path, text, constants)
