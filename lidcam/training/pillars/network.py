"""The network in PyTorch, and as an ONNX file: an encoder of pillars, convolutions over the ground, a head for centres.

After PointPillars (Lang et al., 2019) and CenterPoint (Yin, Zhou, Kraehenbuehl, "Center-based 3D object detection and
tracking", CVPR 2021), and much smaller than either, so that one core of a processor trains and runs it.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from lidcam.pipeline.core.arrays import F32, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS
from lidcam.pipeline.detectors.pillars.grid import FEATURES, STRIDE, Grid
from lidcam.pipeline.detectors.pillars.network import INPUTS, KEY, PillarSpecs
from lidcam.pipeline.detectors.pillars.network import PillarNetwork as WrittenNetwork
from lidcam.training.onnx_graph import FLOAT, INT64, Graph

WIDTH = 32
BLOCKS = (32, 2), (64, 3), (96, 3)  # Channels and convolutions; the first of each block halves the resolution
LIKELY = 0.01  # Probability of an object in each cell before anything is learned


class PillarNetwork(nn.Module):  # type: ignore[misc]  # mypy skips torch
    """Turns the points in pillars into the numbers of each cell of the output."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(len(FEATURES), WIDTH, bias=False), nn.BatchNorm1d(WIDTH), nn.ReLU())
        self.blocks, self.ups = nn.ModuleList(), nn.ModuleList()
        before, scale = WIDTH, 1
        for channels, layers in BLOCKS:
            parts = [layer for row in range(layers) for layer in _convolved(channels if row else before, channels, row)]
            self.blocks.append(nn.Sequential(*parts))
            up = nn.ConvTranspose2d(channels, WIDTH, scale, stride=scale, bias=False)
            self.ups.append(nn.Sequential(up, nn.BatchNorm2d(WIDTH)))
            before, scale = channels, 2 * scale
        self.head = nn.Sequential(*_convolved(WIDTH, WIDTH, 1))
        self.last: Any = nn.Conv2d(WIDTH, classes + BOX_NUMBERS, 1)  # its bias is no `None`
        nn.init.zeros_(self.last.bias)
        nn.init.constant_(self.last.bias[:classes], math.log(LIKELY / (1 - LIKELY)))

    def forward(self, features: Tensor, pillar: Tensor, frames: int, cells: int, *, bfloat16: bool = False) -> Tensor:
        """(B, classes + `BOX_NUMBERS`, H, W) numbers; the first are the log odds that an object of each class is there.

        Args:
            features: (P, F) features of the points of all frames.
            pillar: (P,) int64 pillar of each point; pillars are numbered on from frame to frame.
            frames: Number of frames, B.
            cells: Pillars along x and along y.
            bfloat16: Whether convolutions compute in bfloat16. The encoder does not, because oneDNN would keep code
                for each number of points, some megabytes in each step.
        """
        encoded = self.encoder(features)
        canvas = encoded.new_zeros((frames * cells * cells, WIDTH))
        canvas = canvas.scatter_reduce(0, pillar[:, None].expand(-1, WIDTH), encoded, "amax")
        image = canvas.view(frames, cells, cells, WIDTH).permute(0, 3, 1, 2)  # channels last: faster on processors
        total = encoded.new_zeros(())
        with torch.autocast(features.device.type, torch.bfloat16, bfloat16):
            for block, up in zip(self.blocks, self.ups, strict=True):
                image = block(image)
                total = total + up(image)
            return cast(Tensor, self.last(self.head(torch.relu(total))).float())


def _convolved(before: int, channels: int, row: int) -> list[nn.Module]:
    convolution = nn.Conv2d(before, channels, 3, stride=1 if row else STRIDE, padding=1, bias=False)
    return [convolution, nn.BatchNorm2d(channels), nn.ReLU()]


def onnx_bytes(network: PillarNetwork, specs: PillarSpecs, learned: Grid) -> bytes:
    """Content of a file; the same network gives the same bytes.

    Normalisation stays a separate node, so that a training can continue from the file; onnxruntime folds it into the
    convolution before it.

    Args:
        network: Trained network.
        specs: Metadata of the file. Its grid may be larger than the one of the training, because convolutions are the
            same everywhere.
        learned: Grid of the training.
    """
    network = network.eval().cpu()
    graph, cells = Graph(), specs.grid.cells
    parts: Any = network  # torch has no types for what is in its modules
    linear, norm, _ = parts.encoder
    weight = _arrays(linear)[0].T * _distance_factors(specs.grid, learned)
    encoded = graph.add_node("BatchNormalization", graph.add_node("MatMul", "features", weight), *_arrays(norm))
    encoded = graph.add_node("Relu", encoded)
    empty = graph.add_node("ConstantOfShape", np.array([cells * cells, WIDTH]))
    canvas = graph.add_node("ScatterND", empty, "pillar", encoded, reduction="max")
    rows = graph.add_node("Transpose", canvas, perm=[1, 0])
    image = graph.add_node("Reshape", rows, np.array([1, WIDTH, cells, cells]))
    total = ""
    for block, (layer, norm) in zip(parts.blocks, parts.ups, strict=True):
        image = _convolutions(graph, image, block)
        sides = [*layer.stride]
        raised = graph.add_node("ConvTranspose", image, *_arrays(layer), strides=sides, kernel_shape=sides)
        raised = graph.add_node("BatchNormalization", raised, *_arrays(norm))
        total = graph.add_node("Add", total, raised) if total else raised
    image = _convolutions(graph, graph.add_node("Relu", total), network.head)
    graph.add_node("Conv", image, *_arrays(network.last), name="numbers")
    side = cells // STRIDE
    inputs = (INPUTS[0], FLOAT, ("points", len(FEATURES))), (INPUTS[1], INT64, ("points", 1))
    outputs = [("numbers", FLOAT, (1, len(specs.classes) + BOX_NUMBERS, side, side))]
    return graph.file(inputs, outputs, {KEY: specs.model_dump_json()})


def take_weights(network: PillarNetwork, file: Path, classes: Sequence[str], learned: Grid, share: float = 1.0) -> None:
    """Load the weights of a file from `onnx_bytes` into a network for some classes, which learns in a grid.

    With a share below 1, the weights become a mean of both, in which those of the file have this share. Raises
    ModelError if the file cannot be read, or holds another kind of network.
    """
    specs = WrittenNetwork(file).specs
    wanted = f"{file}: expected a network of this version of lidcam that finds {', '.join(classes)} in pillars of"
    found, cell_m = [one.name for one in specs.classes], specs.grid.cell_m
    if found != [*classes] or cell_m != learned.cell_m:
        raise ModelError(f"{wanted} {learned.cell_m:g} m, found {', '.join(found)} in {cell_m:g} m")
    pairs: Any = zip(network.blocks, network.ups, strict=True)
    parts: list[Any] = [network.encoder, *(part for pair in pairs for part in pair), network.head, [network.last]]
    places = [one for part in parts for layer in part for one in _tensors(layer)]
    constants = onnx.load(file).graph.initializer
    numbers = [numpy_helper.to_array(one) for one in constants if one.data_type == FLOAT]
    if [one.shape for one in numbers] != [places[0].T.shape, *(one.shape for one in places[1:])]:
        raise ModelError(f"{wanted} {learned.cell_m:g} m, found one with other layers: train it anew")
    numbers[0] = (numbers[0] / _distance_factors(specs.grid, learned)).T
    with torch.no_grad():
        for place, values in zip(places, numbers, strict=True):
            place.lerp_(torch.from_numpy(values.copy()).to(place.device), share)


def _convolutions(graph: Graph, image: str, layers: Iterable[Any]) -> str:
    """Add convolutions, each followed by its normalisation and a ReLU."""
    parts = [*layers]
    for layer, norm in zip(parts[::3], parts[1::3], strict=True):
        pads = [*layer.padding] * 2
        image = graph.add_node("Conv", image, *_arrays(layer), strides=[*layer.stride], pads=pads)
        image = graph.add_node("Relu", graph.add_node("BatchNormalization", image, *_arrays(norm)))
    return image


def _arrays(layer: Any) -> list[Array]:
    return [np.asarray(one.detach().numpy()) for one in _tensors(layer)]


def _tensors(layer: Any) -> list[Any]:
    """Tensors of a layer in the order of its node's inputs: weights, bias, mean and variance, as far as it has them."""
    names = ("weight", "bias", "running_mean", "running_var")
    return [one for name in names if (one := getattr(layer, name, None)) is not None]


def _distance_factors(written: Grid, learned: Grid) -> F32:
    """(F, 1) factors of weights by feature, because the distance is measured in half sides of the grid."""
    factors = np.ones((len(FEATURES), 1), np.float32)
    factors[FEATURES.index("distance")] = written.half_m / learned.half_m
    return factors
